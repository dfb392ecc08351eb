"""What is compared must be the same work: the variants of a benchmark give the same maps. Nothing here is timed."""

import json
import struct

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import fusion, many, rules, wire
from benchmarks.inputs import ORION, office, orion_walk
from benchmarks.integration import kernels
from benchmarks.peers.build import write_scans
from benchmarks.swarm_in_process import Swarm
from benchmarks.table import Row, compared, interleaved, printed
from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import Lattice
from mapping.raster import raster
from mapping.scan import INVALID, NO_RETURN
from mapping.tiles import map_digest, summed


def test_all_kernels_make_the_same_map_of_the_office():
    log = office(scans=20)
    digests = {
        map_digest(integrated({}, log.scans, log.sensor, EvidenceModel(), Lattice(50), kernel))
        for kernel in kernels().values()
    }
    assert len(digests) == 1


def test_others_get_the_scans_that_we_map(tmp_path):
    log = office(scans=3, beams=7)
    write_scans(log, 0.05, tmp_path / "scans")
    data = (tmp_path / "scans").read_bytes()
    scans, beams, cell, first, step, max_range = struct.unpack_from("<iidddd", data)
    assert (scans, beams, cell, max_range) == (3, 7, 0.05, 20.0)
    assert first % (2 * np.pi) == pytest.approx(3 * np.pi / 2, abs=1e-4)
    assert step == pytest.approx(np.pi / 6, abs=2e-4)
    rows = np.frombuffer(data, np.dtype([("pose", "<f8", 3), ("ranges", "<f4", 7)]), offset=40)
    assert np.array_equal(rows["pose"], log.poses)
    ours = log.scans.ranges.astype(float) / 1000
    silent = (log.scans.ranges == INVALID) | (log.scans.ranges == NO_RETURN)
    assert np.allclose(rows["ranges"][~silent], ours[~silent], atol=0.0006)
    assert (rows["ranges"][log.scans.ranges == NO_RETURN] > 20).all()


def test_a_swarm_in_one_process_has_the_map_of_all_scans():
    swarm = Swarm(3, raster)
    for robot in range(3):
        swarm.sense(robot, orion_walk(10, robot))
    assert not swarm.agreed()
    assert swarm.settle(30.0) is not None
    maps = [integrated({}, orion_walk(10, robot), ORION, EvidenceModel(), Lattice(20)) for robot in range(3)]
    assert {peer.fusion.digest() for peer in swarm.peers.values()} == {map_digest(summed(maps))}
    assert swarm.said > 3
    assert swarm.sent.keys() == {"r0", "r1", "r2"}


def test_the_peer_whose_updates_are_timed_applies_them_all():
    follower = fusion._Follower(3, 10, raster)
    follower.seconds_an_update()
    follower.seconds_an_update()
    replicas = follower._peer.replicas.values()
    assert follower._peer.fusion.digest() == map_digest(summed([replica.state.cells for replica in replicas]))


def test_swarms_of_all_sizes_agree(monkeypatch):
    rows = many.of_size(3)
    assert not any("not agree" in row.note for row in rows)
    monkeypatch.setattr(many, "_PATIENCE", 0.0)
    monkeypatch.setattr(many.Swarm, "settle", lambda swarm, seconds: None)
    assert any("not agree" in row.note for row in many.of_size(2))


def test_the_sum_of_single_writers_is_the_same_everywhere_and_errs_least():
    result = rules._run(seed=7)
    assert result["sum of single writers"][1] == 0.0
    assert result["sum of single writers"][0] == min(wrong for wrong, _ in result.values())
    assert result["own cell wins, else the last remote"][1] > 0.0


def test_full_grids_cost_their_cells_each_time():
    walk = orion_walk(10, 1)
    whole = integrated({}, walk, ORION, EvidenceModel(), Lattice(20))
    assert wire._full_grids(walk, ORION, Lattice(20), every=10) == wire.Grid.of(whole, Lattice(20)).evidence.size


def test_variants_are_measured_in_turn():
    turns = []

    def variant(name):
        def measured():
            turns.append(name)
            return float(len(turns))

        return measured

    figures = interleaved({"a": variant("a"), "b": variant("b")}, 2)
    assert turns == ["a", "b", "a", "b"]
    rows = compared(figures, "s", "a")
    assert rows == [Row("a", 2.0, "s", 1.0, 3.0, 1.0), Row("b", 3.0, "s", 2.0, 4.0, (2 / 1 + 4 / 3) / 2)]
    assert "x 1.67" in printed("title", rows)


def test_a_machine_that_slows_down_between_turns_changes_no_ratio():
    rows = compared({"a": [1.0, 10.0, 3.0, 5.0], "b": [2.0, 20.0, 6.0, 10.0], "once": [7.0]}, "s", "a")
    assert [row.ratio for row in rows] == [1.0, 2.0, 7.0]
    assert [row.ratio for row in compared({"a": [1.0, 2.0]}, "s")] == [0.0]


def test_the_command_prints_a_table_and_writes_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["benchmarks", "rules", "--json", str(tmp_path / "out.json")])
    assert command.main() == 0
    assert "sum of single writers: wrong" in capsys.readouterr().out
    written = json.loads((tmp_path / "out.json").read_text())
    assert written["benchmarks"]["rules"]["rows"][0]["unit"] == "%"


def test_an_unknown_benchmark_is_a_mistake(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["benchmarks", "ruls"])
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 2
    assert "ruls" in capsys.readouterr().err
