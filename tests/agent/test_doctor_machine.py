"""The doctor at a machine: every check can find both that all is well and that it is not."""

from __future__ import annotations

import grp
import importlib.metadata
import os
import socket
import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from agent import doctor_machine
from agent.finding import Finding, worst


def the_one(found: list[Finding], verdict: str) -> Finding:
    (finding,) = [it for it in found if it.verdict == verdict]
    assert finding.remedy
    return finding


def test_this_machine_can_run_a_swarm(tmp_path) -> None:
    found = list(doctor_machine.machine(tmp_path))
    assert [it for it in found if it.verdict == "problem"] == []
    subjects = {"orion", "packages", "cosine table", "kernels", "clock", "disk", "serial rights", "multicast"}
    assert subjects <= {it.subject for it in found}


def test_what_a_checkout_needs_is_what_its_project_file_says() -> None:
    needed = {requirement.name: requirement for requirement in doctor_machine.requirements()}
    assert {"numpy", "pyserial", "eclipse-zenoh", "numba", "packaging"} <= needed.keys()
    assert "fast" in str(needed["numba"].marker)
    assert needed["numpy"].marker is None


def test_a_missing_an_old_and_an_optional_package_are_told_apart() -> None:
    needed = [
        Requirement("numpy"),
        Requirement("no-such-package>=1"),
        Requirement("pyserial>=1000"),
        Requirement("no-such-toy>=1; extra == 'toys'"),
        Requirement("no-such-tool>=1; extra == 'test'"),
        Requirement("no-such-relic; python_version < '3'"),
    ]
    found = list(doctor_machine.packages(needed))
    problems = {it.found: it.remedy for it in found if it.verdict == "problem"}
    version = importlib.metadata.version("pyserial")
    assert problems == {
        "no-such-package is missing": "pip install 'no-such-package>=1'",
        f"pyserial is {version}, expected >=1000": "pip install 'pyserial>=1000'",
    }
    fine = " ".join(it.found for it in found if it.verdict == "ok")
    assert f"numpy {importlib.metadata.version('numpy')}" in fine
    assert "no-such-toy (extra toys)" in fine
    assert "tool" not in fine
    assert "relic" not in fine


def test_an_extra_of_an_unknown_version_does_not_stop_the_swarm() -> None:
    found = list(doctor_machine.packages([Requirement("pyserial>=1000; extra == 'toys'")]))
    assert worst(found) == "warning"


def test_another_distribution_that_owns_a_package_of_ours_is_a_problem(monkeypatch) -> None:
    monkeypatch.setattr(importlib.metadata, "packages_distributions", lambda: {"swarm": ["swarm-of-somebody"]})
    finding = the_one(list(doctor_machine.own_packages()), "problem")
    assert "pip uninstall swarm-of-somebody" in finding.remedy


def test_packages_from_two_places_are_a_problem(monkeypatch, tmp_path) -> None:
    (tmp_path / "mapping").mkdir()
    (tmp_path / "mapping" / "__init__.py").touch()
    monkeypatch.delitem(sys.modules, "mapping")
    monkeypatch.syspath_prepend(tmp_path)
    finding = the_one(list(doctor_machine.own_packages()), "problem")
    assert str(tmp_path) in finding.found


def test_a_cosine_table_of_its_own_is_a_problem(monkeypatch) -> None:
    import numpy as np

    cosine = np.cos
    monkeypatch.delitem(sys.modules, "mapping.cosine")
    monkeypatch.setattr(np, "cos", lambda angles: cosine(angles) * 1.001)
    assert doctor_machine.cosine_table().verdict == "problem"


def test_a_clock_before_this_program_and_one_nobody_sets_are_told() -> None:
    long_ago = doctor_machine.clock(lambda: 86_400.0, lambda: True)
    assert (long_ago.verdict, "earlier" in long_ago.found) == ("warning", True)
    assert doctor_machine.clock(synchronised=lambda: False).verdict == "warning"
    assert doctor_machine.clock(synchronised=lambda: True).found == "synchronised"
    assert doctor_machine.clock(synchronised=lambda: None).verdict == "ok"


@pytest.mark.parametrize(("room", "verdict"), [(10 << 30, "ok"), (200 << 20, "warning"), (1 << 20, "problem")])
def test_the_disk_has_room_or_not(room: int, verdict: str) -> None:
    finding = doctor_machine.disk(Path("/"), lambda path: room)
    assert finding.verdict == verdict
    assert bool(finding.remedy) == (verdict != "ok")


def test_who_may_not_open_serial_devices_is_told_how_to(monkeypatch) -> None:
    dialout = grp.struct_group(("dialout", "x", 54_321, ["ada"]))

    def group(name: str) -> grp.struct_group:
        if name != "dialout":
            raise KeyError(name)
        return dialout

    monkeypatch.setattr(grp, "getgrnam", group)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(os, "getegid", lambda: 1000)
    monkeypatch.setattr(os, "getgroups", lambda: [1000])
    monkeypatch.setattr("getpass.getuser", lambda: "bob")
    assert "usermod -aG dialout" in doctor_machine.serial_rights().remedy
    monkeypatch.setattr("getpass.getuser", lambda: "ada")
    assert doctor_machine.serial_rights().remedy == "log out and in again"
    monkeypatch.setattr(os, "getgroups", lambda: [1000, 54_321])
    assert doctor_machine.serial_rights().verdict == "ok"


def test_a_network_port_is_free_occupied_or_elsewhere() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        number = taken.getsockname()[1]
        here, finding = doctor_machine.network_port("r1", "127.0.0.1", number)
        assert (here, finding.verdict, finding.found) == (True, "problem", "is occupied")
    here, finding = doctor_machine.network_port("r1", "127.0.0.1", number)
    assert (here, finding.verdict, finding.found) == (True, "ok", "is free")
    here, finding = doctor_machine.network_port("r2", "192.0.2.1", number)  # RFC 5737: nobody's
    assert (here, finding.verdict, finding.found) == (False, "ok", "is another machine's")
    here, finding = doctor_machine.network_port("r3", "a..b", number)
    assert (here, finding.verdict) == (False, "problem")
