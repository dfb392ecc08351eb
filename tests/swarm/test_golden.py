"""The golden logs: numbers, messages and digests that no change may alter, and two ways to reach them.

The log's format, a line each; a session's numbers come before the message that carries them:

    rules CELL_MM OCCUPIED FREE LIMIT
    session ROBOT SESSION MAX_RANGE_MM START_X START_Y START_YAW REPLACED
                                        ("- - -": nobody knows the start pose; "-": it replaces no session)
    beam X_MM Y_MM BEARING
    scan STAMP_MS X_MM Y_MM YAW RANGE...
    cells TY TX INDEX=VALUE...          what a correction changes
    evict SESSION                       it is not summed
    message HEX                         a session, update or control message
    state N CHECK ROOT                  the session's state after it
    controls CHECK                      of all control records, at the end
    map DIGEST                          the sum of all sessions that have a start pose, are not replaced, not evicted

To write the logs anew after the protocol has changed on purpose: python tests/swarm/test_golden.py
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import Cells, Lattice, TileKey
from mapping.pose import QuantisedPose
from mapping.raster import raster
from mapping.scan import INVALID, NO_RETURN, Scans
from mapping.sensor import Beam, Sensor, laser, orion
from mapping.tiles import Tiles, map_digest, summed
from swarm.controls import EVICTED, READMITTED, Controls, StartPose
from swarm.messages import AskControls, Control, Digest, Session, Update, decode, encode
from swarm.replica import Replica
from swarm.scan_block import decode_scans, encode_scans
from swarm.session import Descriptor, Rules
from swarm.tile_block import decode_changes, decode_tiles
from swarm.writer import Publish, Writer

GOLDEN = Path(__file__).parent / "golden"
LOGS = ("swarm", "limit")
ORION = orion()
LASER = laser(9, first=-1.5, step=0.375, max_range=3.0)


class Chance:
    """A linear congruential generator (MMIX): the same numbers in any language."""

    def __init__(self, seed: int) -> None:
        self.state = seed

    def below(self, n: int) -> int:
        self.state = (self.state * 6364136223846793005 + 1442695040888963407) % 2**64
        return (self.state >> 33) % n


def wander(seed: int, count: int, sensor: Sensor, *, leap: int = -1) -> Scans:
    """Scans of a robot that wanders; at scan ``leap`` it is carried far away, and everything about it jumps."""
    chance = Chance(seed)
    x, y, yaw = chance.below(2000) - 1500, chance.below(2000) - 1500, chance.below(65536)
    stamps, poses, ranges = [], [], []
    base = 200 + chance.below(400)
    for m in range(count):
        if m == leap:
            x, y, yaw = x - 1_234_567, y + 76_543, yaw + 30_000
        x, y, yaw = x + chance.below(60) - 20, y + chance.below(60) - 30, (yaw + chance.below(900) - 300) % 65536
        row = [
            (INVALID, NO_RETURN, sensor.max_range_mm)[kind]
            if (kind := chance.below(14)) < 3
            else base + chance.below(40)
            for _ in sensor.beams
        ]
        stamps.append(5_000 + 100 * m + chance.below(7) + (86_400_000 if 0 <= leap <= m else 0))
        poses.append([x, y, yaw])
        ranges.append(row)
    return Scans(np.array(stamps, np.int64), np.array(poses, np.int32), np.array(ranges, np.uint16))


class Log:
    """Writes the lines of one golden log."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        model = rules.model
        self.lines = [f"rules {rules.lattice.cell_mm} {model.occupied} {model.free} {model.limit}"]
        self.maps: dict[str, Tiles] = {}
        self.controls = Controls()

    def session(
        self,
        robot: str,
        session: str,
        sensor: Sensor,
        start: QuantisedPose | None,
        mtu: int,
        publish: Publish = "auto",
        replaces: str = "",
    ) -> None:
        words = " ".join(map(str, start)) if start else "- - -"
        self.lines += ["", f"session {robot} {session} {sensor.max_range_mm} {words} {replaces or '-'}"]
        self.lines += [f"beam {beam.x_mm} {beam.y_mm} {beam.bearing_turn16}" for beam in sensor.beams]
        old = bytes.fromhex(replaces) or None
        descriptor = Descriptor(robot, bytes.fromhex(session), self.rules, sensor, start, old)
        self.lines.append(f"message {encode(Session(descriptor.encode())).hex()}")
        self.replica = Replica(descriptor, raster)
        self.writer = Writer(self.replica, raster, mtu=mtu, publish=publish)
        self.maps.pop(replaces, None)
        if start:
            self.maps[session] = self.replica.state.cells

    def update(self, update: Update) -> None:
        state = self.replica.state
        self.lines.append(f"message {encode(update).hex()}")
        self.lines.append(f"state {state.n} {state.check} {state.root().hex()}")

    def scans(self, scans: Scans) -> None:
        for stamp, pose, ranges in zip(scans.stamps_ms, scans.poses.tolist(), scans.ranges.tolist(), strict=True):
            self.lines.append(" ".join(map(str, ["scan", stamp, *pose, *ranges])))
        self.writer.sense(scans)
        for update, _ in self.writer.updates():
            self.update(update)

    def correction(self, scans: Scans) -> None:
        """All cells become what these scans make them."""
        descriptor, before = self.replica.descriptor, self.replica.state.cells
        after = integrated({}, scans, descriptor.sensor, self.rules.model, self.rules.lattice)
        after |= {key: np.zeros_like(cells) for key, cells in before.items() if key not in after}
        for key in sorted(after):
            old = before[key].ravel() if key in before else np.zeros(1024, np.int32)
            new = after[key].ravel()
            changes = [f"{index}={new[index]}" for index in np.flatnonzero(old != new)]
            self.lines.append(" ".join(["cells", str(key.ty), str(key.tx), *changes]))
        self.writer.correct({key: after[key] for key in sorted(after)})
        for update, _ in self.writer.updates():
            self.update(update)

    def evict(self, session: str) -> None:
        """Two decide at once, and the greater name wins; a third's record is superseded before it comes."""
        subject = bytes.fromhex(session)
        self.lines += ["", f"evict {session}"]
        for revision, issuer, value in (
            (2, b"operator", EVICTED),
            (2, b"observer", READMITTED),
            (1, b"zzzzzzzz", EVICTED),
        ):
            control = Control(Control.EVICT, subject, revision, issuer, value)
            self.lines.append(f"message {encode(control).hex()}")
            self.controls.put(control)
        del self.maps[session]

    def start_pose(self, robot: str, start: StartPose) -> None:
        control = Control(Control.START_POSE, robot.encode(), 1, b"operator", start.pack())
        self.lines += ["", f"message {encode(control).hex()}"]
        self.controls.put(control)

    def text(self) -> str:
        digest = map_digest(summed([*self.maps.values()])).hex()
        return "\n".join([*self.lines, "", f"controls {self.controls.check}", f"map {digest}", ""])


def the_swarm() -> str:
    log = Log(Rules(Lattice(50), EvidenceModel()))
    log.session("r1", "0000000000000001", ORION, QuantisedPose(0, 0, 16384), mtu=32768)
    whole = wander(1, 14, ORION, leap=11)
    log.scans(whole[:6])
    log.scans(whole[6:13])
    log.scans(whole[13:])
    log.session("r2", "a1b2c3d4e5f60718", LASER, QuantisedPose(2150, 1450, 1820), mtu=700, publish="tiles")
    whole = wander(2, 10, LASER)
    log.scans(whole[:7])
    log.scans(whole[7:])
    log.session("r3", "ffffffffffffffff", ORION, QuantisedPose(-900, 40, 60000), mtu=120)
    whole = wander(3, 10, ORION)
    log.scans(whole)
    moved = Scans(whole.stamps_ms, whole.poses + np.array([130, -1700, 0], np.int32), whole.ranges)
    log.correction(moved)
    log.session("r4", "00000000000000ff", ORION, None, mtu=32768)
    unplaced = wander(4, 2, ORION)
    log.scans(unplaced)
    place = QuantisedPose(700, -800, 0)
    log.start_pose("r4", StartPose(place, bytes.fromhex("00000000000000ff")))
    log.session("r4", "00000000000000fe", ORION, place, mtu=32768, replaces="00000000000000ff")
    log.scans(Scans(unplaced.stamps_ms, unplaced.poses + np.array([700, -800, 0], np.int32), unplaced.ranges))
    log.session("r5", "00000000000000aa", ORION, QuantisedPose(1, 2, 3), mtu=32768)
    log.scans(wander(6, 3, ORION))
    log.evict("00000000000000aa")
    return log.text()


def with_a_limit() -> str:
    log = Log(Rules(Lattice(20), EvidenceModel(occupied=120, free=-35, limit=200)))
    log.session("r1", "0000000000000001", ORION, QuantisedPose(0, 0, 0), mtu=32768)
    still = wander(5, 8, ORION)
    still = Scans(still.stamps_ms, np.repeat(still.poses[:1], 8, axis=0), still.ranges)
    log.scans(still[:5])
    log.scans(still[5:])
    return log.text()


WRITTEN = {"swarm": the_swarm, "limit": with_a_limit}


class Golden:
    """One golden log, read: a stranger's program would begin like this."""

    def __init__(self, name: str) -> None:
        self.text = (GOLDEN / f"{name}.txt").read_text()
        self.lines = [line.split() for line in self.text.splitlines() if line and not line.startswith("#")]

    def of(self, word: str) -> Iterator[list[str]]:
        return (rest for first, *rest in self.lines if first == word)

    @property
    def messages(self) -> list[bytes]:
        return [bytes.fromhex(data) for (data,) in self.of("message")]

    @property
    def map_digest(self) -> str:
        [[digest]] = self.of("map")
        return digest


@pytest.fixture(params=LOGS)
def golden(request: pytest.FixtureRequest) -> Golden:
    return Golden(request.param)


def comparable(line: str) -> str:
    """A line of a log, whatever this machine's zlib makes of tiles: their contents instead of their deflate streams."""
    word, _, data = line.partition(" ")
    if word != "message":
        return line
    message = decode(bytes.fromhex(data))
    if not isinstance(message, Update) or message.form == Update.SCANS:
        return line
    content, payload = [], message.payload
    while payload:
        end = 10 + int.from_bytes(payload[8:10], "little")
        content.append((payload[:8], zlib.decompress(payload[10:end], -15)))
        payload = payload[end:]
    return repr((message.session, message.n, message.form, content, message.trail, message.check))


@pytest.mark.parametrize("name", LOGS)
def test_the_log_made_anew_is_the_golden_one(name):
    new, golden = (text.splitlines() for text in (WRITTEN[name](), Golden(name).text))
    assert [comparable(line) for line in new] == [comparable(line) for line in golden]


def test_replaying_the_messages_gives_the_golden_states_and_map(golden):
    replicas: dict[bytes, Replica] = {}
    controls = Controls()
    states = golden.of("state")
    for data in golden.messages:
        message = decode(data)
        if isinstance(message, Session):
            descriptor = Descriptor.decode(message.descriptor)
            replicas[descriptor.session] = Replica(descriptor, raster)
        elif isinstance(message, Control):
            controls.put(message)
        else:
            replica = replicas[message.session]
            list(replica.offer(message))
            state = replica.state
            assert [str(state.n), str(state.check), state.root().hex()] == next(states)
            assert state.sound()
    out = controls.evicted | {replica.descriptor.replaces for replica in replicas.values()}
    maps = [each.state.cells for session, each in replicas.items() if each.descriptor.start and session not in out]
    assert [[str(controls.check)]] == [*golden.of("controls")]
    assert map_digest(summed(maps)).hex() == golden.map_digest


def test_messages_decode_to_the_numbers_and_encode_to_the_same_bytes(golden):  # noqa: PLR0912 - one line kind each
    """Scans of form SCANS, trails of form TILES, changed cells of form CELLS: all are the log's plain numbers."""
    numbers: list[list[int]] = []
    changes: dict[tuple[int, int], dict[int, int]] = {}
    descriptor, cells = None, {}
    for word, *rest in golden.lines:
        if word == "scan":
            numbers.append([int(each) for each in rest])
        elif word == "cells":
            ty, tx, *pairs = rest
            changes[int(ty), int(tx)] = {int(i): int(v) for i, v in (pair.split("=") for pair in pairs)}
        elif word == "message":
            message = decode(bytes.fromhex(rest[0]))
            assert encode(message) == bytes.fromhex(rest[0])
            if isinstance(message, Session):
                assert not numbers
                assert not changes
                descriptor, cells = Descriptor.decode(message.descriptor), {}
                assert descriptor.encode() == message.descriptor
            if not isinstance(message, Update):
                continue
            beams, far = len(descriptor.sensor.beams), descriptor.sensor.max_range_mm
            if message.form == Update.SCANS:
                scans = decode_scans(message.payload, beams, far)
                assert encode_scans(scans) == message.payload
                expected, numbers = numbers[: len(scans)], numbers[len(scans) :]
                assert [
                    [*row] for row in np.column_stack([scans.stamps_ms, scans.poses, scans.ranges]).tolist()
                ] == expected
                cells |= integrated(cells, scans, descriptor.sensor, descriptor.rules.model, descriptor.rules.lattice)
            elif message.form == Update.TILES:
                cells |= decode_tiles(message.payload)
                if message.trail:
                    scans = decode_scans(message.trail, 0, 0)
                    expected, numbers = numbers[: len(scans)], numbers[len(scans) :]
                    assert np.column_stack([scans.stamps_ms, scans.poses]).tolist() == [row[:4] for row in expected]
            else:
                for key, after in decode_changes(message.payload, cells).items():
                    old = cells[key].ravel() if key in cells else np.zeros(1024, np.int32)
                    new = after.ravel()
                    expected = changes[tuple(key)]
                    for index in np.flatnonzero(old != new).tolist():
                        assert expected.pop(index) == new[index]
                    if not expected:  # one update need not hold a whole tile's changes
                        del changes[tuple(key)]
                    cells[key] = after
    assert not numbers
    assert not changes


def test_a_client_in_plain_python_reaches_the_golden_states_and_map(golden, plain_client):
    client = plain_client.Client()
    states = golden.of("state")
    for data in golden.messages:
        client.take(data)
        if decode(data).KIND == Update.KIND:
            state = client.states[decode(data).session]
            assert [str(state.n), str(state.check()), state.root()] == next(states)
    assert [[str(client.controls_check)]] == [*golden.of("controls")]
    assert plain_client.map_digest(client.map()) == golden.map_digest


def test_from_the_plain_numbers_alone_plain_python_reaches_the_golden_map(plain_client):
    """Without any message: sessions, beams and scans as written, corrections as cells, evictions."""
    golden = Golden("swarm")
    cell, occupied, free, limit = (int(word) for word in next(golden.of("rules")))
    maps = {}
    for word, *rest in golden.lines:
        if word == "evict":
            del maps[rest[0]]
        elif word == "session":
            robot, session, far, *start, replaced = rest
            maps.pop(replaced, None)
            of = plain_client.Descriptor(robot, bytes.fromhex(session), cell, occupied, free, limit, int(far), [], None)
            tiles: dict[tuple[int, int], list[int]] = {}
            if start[0] != "-":
                maps[session] = tiles
        elif word == "beam":
            of.beams.append((*(int(each) for each in rest), 0))
        elif word == "scan":
            stamp, x, y, yaw, *ranges = (int(each) for each in rest)
            plain_client.add_scan(tiles, (stamp, x, y, yaw, ranges), of)
        elif word == "cells":
            tile = tiles.setdefault((int(rest[0]), int(rest[1])), [0] * 1024)
            for index, value in (pair.split("=") for pair in rest[2:]):
                tile[int(index)] = int(value)
    total: dict[tuple[int, int], list[int]] = {}
    for tiles in maps.values():
        for key, tile in tiles.items():
            total[key] = [a + b for a, b in zip(total.get(key, [0] * 1024), tile, strict=True)]
    assert plain_client.map_digest(total) == golden.map_digest


@pytest.mark.parametrize("limit", [0, 150])
def test_beams_with_a_width_are_worth_the_same_in_plain_python(plain_client, limit):
    sensor = Sensor((Beam(30, 0, 0, 2276), Beam(-5, 7, 16_384, 900), Beam(0, 0, 40_000, 0)), 800)
    model, lattice = EvidenceModel(limit=limit), Lattice(20)
    descriptor = Descriptor("r1", bytes(8), Rules(lattice, model), sensor, QuantisedPose(0, 0, 0))
    of = plain_client.decode_descriptor(descriptor.encode())
    scans = wander(3, 12, sensor)
    near = Scans(scans.stamps_ms[:1], scans.poses[:1], np.array([[5, 1, 1]], np.uint16))  # rays of one cell
    tiles: dict[tuple[int, int], list[int]] = {}
    ours: dict[TileKey, Cells] = {}
    for piece in (scans, near):
        ours |= integrated(ours, piece, sensor, model, lattice)
        for pose, ranges in zip(piece.poses.tolist(), piece.ranges.tolist(), strict=True):
            plain_client.add_scan(tiles, (0, *pose, ranges), of)
    assert plain_client.map_digest(tiles) == map_digest(ours).hex()


def test_the_documented_fan_in_plain_python(plain_client):
    of = plain_client.Descriptor("r1", bytes(8), 20, 85, -40, 0, 800, [], None)
    assert plain_client.fan(2276, of) == [252 * k for k in range(-9, 10)]


def test_the_logs_hold_what_they_are_meant_to(golden):
    scans = [[int(each) for each in rest] for rest in golden.of("scan")]
    readings = [reading for scan in scans for reading in scan[4:]]
    assert INVALID in readings
    assert NO_RETURN in readings
    assert min(scan[1] for scan in scans) < 0
    if next(golden.of("rules"))[-1] == "0":
        forms = {message.form for message in map(decode, golden.messages) if isinstance(message, Update)}
        assert forms == {Update.SCANS, Update.CELLS, Update.TILES}
        assert len(scans) == 41


def test_the_table_of_cosines_in_plain_python_is_the_documented_one(plain_client):
    document = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text()
    assert plain_client.table_sha256() in document


def test_the_examples_in_the_document_are_what_the_code_makes(plain_client):
    """Session, update and correction of the document, by the plain client; and its digests."""
    document = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text()
    blocks = re.findall(r"```text\n(.*?)```", document, re.DOTALL)
    messages = [
        bytes.fromhex(part) for block in blocks for part in block.split("\n\n") if re.fullmatch(r"[0-9a-f\s]+", part)
    ]
    client, replica = plain_client.Client(), None
    kinds, controls = set(), Controls()
    for data in messages:
        if data[:2] not in {bytes([0x90 + size, 1]) for size in range(3, 9)}:
            continue
        message = decode(data)
        kinds.add(message.KIND)
        if isinstance(message, Session | Update | Control):
            client.take(data)
        if isinstance(message, Control):
            controls.put(message)
        if isinstance(message, AskControls):
            assert message.check == controls.check == client.controls_check
        if isinstance(message, Digest):
            assert f"their check is {message.controls}" in document
        if isinstance(message, Session):
            replica = Replica(Descriptor.decode(message.descriptor), raster)
        if isinstance(message, Update):
            list(replica.offer(message))
            assert replica.state.root().hex() in document
            assert map_digest(replica.state.cells).hex() in document
            assert plain_client.map_digest(client.map()) in document
            for key, mark in replica.state.marks.items() if message.n == 1 else ():
                assert f"| {key.ty} | {key.tx} | 1 | {mark.hash} |" in document
    assert replica.state.n == 2
    assert kinds == {*range(1, 12)}


if __name__ == "__main__":
    GOLDEN.mkdir(exist_ok=True)
    for each, write in WRITTEN.items():
        (GOLDEN / f"{each}.txt").write_text(write())
