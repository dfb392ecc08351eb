"""What a peer keeps, and what comes back of it: after any end, any damage, and any trouble with the place."""

from __future__ import annotations

import random
import shutil
import sqlite3
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable
from itertools import chain, count, repeat
from pathlib import Path

import numpy as np
import pytest

from agent.errors import UserError
from agent.keeper import Keeper, NoKeeper
from agent.node import NoBody, Node
from agent.readings import Readings
from agent.state_reader import read, read_journal
from agent.team_mates import NoMates
from mapping.evidence import EvidenceModel
from mapping.integrate import integrated
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.sensor import orion
from mapping.tiles import Tiles, map_digest, summed
from swarm.messages import Hello, Update, decode
from swarm.session import Rules
from transport.in_process import Network

RULES = Rules(Lattice(50), EvidenceModel())
ORIGIN, ELSEWHERE = QuantisedPose(0, 0, 0), QuantisedPose(2150, 1450, 25486)
SWARM = "test"
_COUNT = count()


class Body(NoBody):
    """A robot that wanders: so many scans, some a turn."""

    def __init__(self, seed: int, count: int, a_turn: int = 1) -> None:
        super().__init__(orion())
        chance = np.random.default_rng(seed)
        poses = np.cumsum(chance.uniform(-0.2, 0.25, (count, 3)), axis=0)
        self.readings = Readings(np.arange(count) * 100, poses, chance.uniform(0.1, 2.5, (count, 5)))
        self.given = 0
        self._a_turn = a_turn

    def read(self, until: float) -> Readings:
        rows = slice(self.given, min(self.given + self._a_turn, len(self.readings))) if until else slice(0, 0)
        self.given = max(self.given, rows.stop)
        return Readings(self.readings.stamps_ms[rows], self.readings.poses[rows], self.readings.ranges[rows])

    @property
    def done(self) -> bool:
        return self.given == len(self.readings)

    def map(self, start: QuantisedPose) -> Tiles:
        """The map of all its scans, from a start pose that was right from the beginning."""
        return integrated({}, self.readings.scans(start, self.sensor), self.sensor, RULES.model, RULES.lattice)


class Swarm:
    """Nodes on one network under fake time, those that have a folder with their state in it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.network = Network(seed=1)
        self.nodes: dict[str, Node] = {}
        self._buses: dict[str, object] = {}
        self._keepers: dict[str, Keeper] = {}

    def join(self, name: str, body: Body | None = None, *, start: QuantisedPose | None = ORIGIN, state: bool = True):
        bus = self.network.bus(f"{name}.{next(_COUNT)}")
        keeper = Keeper(self.folder, name, SWARM, RULES) if state else NoKeeper()
        role = Hello.OBSERVER if body is None else Hello.ROBOT
        hello = Hello(role, name.encode(), b"test")
        node = Node(bus, RULES, hello, now=self.network.now, body=body, speed=1.0, keeper=keeper)
        if body is not None:
            signs = chain(".", repeat("+"))  # . is a run's first session
            new_id = (f"{name}{next(signs)}{next(_COUNT):5}".encode() for _ in repeat(None))
            node.open_session(name, start, "auto", NoMates(), lambda: next(new_id))
        self.nodes[name], self._buses[name], self._keepers[name] = node, bus, keeper
        return node

    def crash(self, *names: str) -> None:
        """They vanish, and what they have not written is lost."""
        for name in names or [*self.nodes]:
            del self.nodes[name]
            self.network.crash(self._buses.pop(name).peer)
            keeper = self._keepers.pop(name)
            if isinstance(keeper, Keeper):
                keeper.close()

    def turn(self) -> None:
        self.network.advance(self.network.now + 0.06)
        for name, node in self.nodes.items():
            node.turn(self.network.now, self._buses[name].receive())

    def until(self, condition: Callable[[], bool], turns: int = 2000) -> None:
        for _ in range(turns):
            if condition():
                return
            self.turn()
        pytest.fail("it does not come to that")

    def agrees(self, digest: bytes) -> bool:
        return all(node.peer.fusion.digest() == digest for node in self.nodes.values())

    def run(self, turns: int) -> None:
        for _ in range(turns):
            self.turn()


@pytest.fixture
def swarm(tmp_path: Path):
    swarm = Swarm(tmp_path)
    yield swarm
    swarm.crash()


def digest_of(*maps: Tiles) -> bytes:
    return map_digest(summed(maps))


# --- coming back


def test_when_all_robots_are_gone_an_observer_that_restarts_gives_newcomers_the_map(swarm) -> None:
    bodies = {"r1": Body(1, 130), "r2": Body(2, 77)}
    for name, body in bodies.items():
        swarm.join(name, body, start=ELSEWHERE if name == "r2" else ORIGIN, state=False)
    swarm.join("observer")
    whole = digest_of(bodies["r1"].map(ORIGIN), bodies["r2"].map(ELSEWHERE))
    swarm.until(lambda: swarm.agrees(whole))
    swarm.run(20)  # others' sessions are kept once a second
    swarm.crash()
    observer = swarm.join("observer")
    assert observer.peer.fusion.digest() == whole  # before it has heard from anybody
    assert observer.summary()["state"]["restored"] == {"sessions": 2, "updates": 130 + 77}
    swarm.join("late", state=False)
    swarm.until(lambda: swarm.agrees(whole))


def test_a_robot_that_restarts_opens_a_new_session_and_continues_none(swarm) -> None:
    bodies = [Body(1, 33), Body(2, 20)]
    for k, body in enumerate(bodies):
        robot = swarm.join("r1", body)
        swarm.until(lambda body=body: body.done)
        swarm.run(3)
        assert robot.peer.fusion.digest() == digest_of(*(each.map(ORIGIN) for each in bodies[: k + 1]))
        swarm.crash()
    first, second = robot.peer.replicas.values()
    assert (first.state.n, second.state.n) == (33, 20)
    assert robot.own is not None
    assert robot.own.descriptor == second.descriptor


def test_an_update_is_on_disk_before_it_is_on_the_bus(swarm) -> None:
    robot = swarm.join("r1", Body(1, 50))
    swarm.join("observer", state=False)
    bus = swarm._buses["r1"]
    kept_first = []
    publish = bus.publish

    def look(topic: str, payload: bytes) -> None:
        message = decode(payload)
        if isinstance(message, Update):
            (session,) = read(swarm.folder / "r1.sqlite", SWARM, RULES).sessions
            sensed = read_journal(swarm.folder / "r1.sqlite", message.session, orion())
            kept_first.append(session.checkpoint.n + len(session.updates) == message.n == len(sensed))
        publish(topic, payload)

    bus.publish = look
    swarm.until(lambda: robot.status()["done"])
    assert kept_first == [True] * 50


def test_nothing_is_written_when_there_is_no_news(swarm) -> None:
    robot = swarm.join("r1", Body(1, 30))
    swarm.join("observer")
    swarm.until(lambda: robot.status()["done"])
    swarm.run(40)
    before = [path.read_bytes() for path in sorted(swarm.folder.glob("*.sqlite-wal"))]
    swarm.run(200)
    assert [path.read_bytes() for path in sorted(swarm.folder.glob("*.sqlite-wal"))] == before
    assert len(before) == 2


def test_decisions_and_replaced_sessions_are_kept(swarm) -> None:
    swarm.join("r1", Body(1, 30), state=False)
    other = Body(2, 30)
    r2 = swarm.join("r2", other, state=False)
    observer = swarm.join("observer")
    swarm.until(lambda: observer.status()["positions"] and sum(observer.status()["positions"].values()) == 60)
    (evicted,) = [each for each in observer.peer.replicas if each.startswith(b"r1")]
    observer.peer.evict(evicted, swarm.network.now)
    observer.peer.set_start_pose("r2", ELSEWHERE, swarm.network.now)
    corrected = digest_of(other.map(ELSEWHERE))
    swarm.until(lambda: swarm.agrees(corrected) and r2.status()["done"])
    swarm.run(20)
    kept = observer.peer
    swarm.crash()
    back = swarm.join("observer").peer
    assert back.fusion.digest() == corrected
    assert (back.controls.check, back.replaced) == (kept.controls.check, kept.replaced)
    assert back.descriptors == kept.descriptors
    assert {each: replica.state.root() for each, replica in back.replicas.items()} == {
        each: replica.state.root() for each, replica in kept.replicas.items()
    }


# --- a start pose that is corrected while the robot is away


@pytest.mark.parametrize("told", ["before it is back", "after it is back"])
def test_a_correction_that_waited_for_the_robot_sets_its_earlier_run_right(swarm, told) -> None:
    before, after = Body(1, 60), Body(2, 25)
    observer = swarm.join("observer")
    robot = swarm.join("r1", before)
    swarm.until(lambda: robot.status()["done"])
    swarm.run(5)
    swarm.crash("r1")
    if told == "before it is back":
        observer.peer.set_start_pose("r1", ELSEWHERE, swarm.network.now)
    robot = swarm.join("r1", after)
    if told == "after it is back":
        swarm.run(3)
        observer.peer.set_start_pose("r1", ELSEWHERE, swarm.network.now)
    right = digest_of(before.map(ELSEWHERE), after.map(ELSEWHERE))
    wrong_before = digest_of(before.map(ORIGIN), after.map(ELSEWHERE))
    swarm.until(lambda: robot.status()["done"] and (swarm.agrees(right) or swarm.agrees(wrong_before)))
    # a record names the session that it is about: one given after the new run began is about that
    assert swarm.agrees(right if told == "before it is back" else wrong_before)
    swarm.crash("r1")
    robot = swarm.join("r1", Body(3, 1))
    swarm.run(40)
    replaced = [each for each in robot.peer.replaced.values() if each.startswith(b"r1+")]
    swarm.run(100)
    assert [each for each in robot.peer.replaced.values() if each.startswith(b"r1+")] == replaced  # it is done once


def test_a_robot_that_dies_while_it_sets_an_earlier_run_right_does_it_again(swarm) -> None:
    before = Body(1, 5000, a_turn=100)
    observer = swarm.join("observer")
    robot = swarm.join("r1", before)
    swarm.until(lambda: robot.status()["done"])
    swarm.run(5)
    swarm.crash("r1")
    observer.peer.set_start_pose("r1", ELSEWHERE, swarm.network.now)
    for _ in range(2):
        robot = swarm.join("r1", Body(2, 0))
        swarm.until(
            lambda: any(each.startswith(b"r1+") and replica.state.n for each, replica in observer.peer.replicas.items())
        )
        assert not swarm.agrees(digest_of(before.map(ELSEWHERE)))
        swarm.crash("r1")
    robot = swarm.join("r1", Body(2, 0))
    swarm.until(lambda: robot.status()["done"] and swarm.agrees(digest_of(before.map(ELSEWHERE))))


# --- any end


def test_a_robot_that_is_killed_at_any_instruction_comes_back_with_a_true_past_state(tmp_path) -> None:
    """And nothing that it had published is missing, neither of its sessions nor of its journals."""
    runs = 24
    script = Path(__file__).with_name("a_keeper.py")
    root = Path(__file__).parents[2]
    subprocess.run(
        [sys.executable, str(script), str(tmp_path), str(runs), "1"],
        check=True,
        env={"PYTHONPATH": str(root)},
        timeout=120,
    )
    history: dict[str, dict[int, str]] = defaultdict(dict)
    published = {}
    for k in range(runs):
        path = tmp_path / f"history-{k}"
        for line in path.read_text().splitlines() if path.exists() else ():
            match line.split():
                case ["published", n, rows]:
                    published[b"r1.%5d" % k] = int(n), int(rows)
                case [session, n, state]:
                    assert history[session].setdefault(int(n), state) == state
    assert len([n for n, _ in published.values() if n]) > runs // 4
    keeper = Keeper(tmp_path, "r1", SWARM, RULES)
    node = Node(Network(seed=1).bus("r1"), RULES, Hello(Hello.ROBOT, b"r1", b"test"), now=0.0, keeper=keeper)
    assert node.summary()["state"]["set_aside"] == []
    assert keeper.status == ""
    for session, replica in node.peer.replicas.items():
        assert history[session.hex()].get(replica.state.n) == replica.state.root().hex()
    for session, (n, rows) in published.items():
        assert node.peer.replicas[session].state.n >= n
        sensed = read_journal(keeper.path, session, orion())
        assert len(sensed) >= rows
        assert sensed.stamps_ms.tolist() == [100 * (row + 1) for row in range(len(sensed))]
    keeper.close()


# --- any damage


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory):
    """A robot's folder as a kill leaves it, another as an orderly end does, and the history of all its states."""
    folder = tmp_path_factory.mktemp("made")
    swarm = Swarm(folder / "live")
    history: dict[bytes, dict[int, bytes]] = defaultdict(lambda: {0: b""})
    swarm.join("r1", Body(1, 70))
    swarm.join("r2", Body(2, 45), state=False)
    for _ in range(90):
        swarm.turn()
        for session, replica in swarm.nodes["r1"].peer.replicas.items():
            history[session][replica.state.n] = map_digest(replica.state.cells)
    shutil.copytree(swarm.folder, folder / "killed")
    swarm.crash()
    shutil.copytree(swarm.folder, folder / "ended")
    return folder, history


def damage(chance: random.Random, content: bytes) -> bytes:
    data = bytearray(content)
    match chance.choice(["flip", "flips", "cut", "zeros", "swap"]):
        case "flip":
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        case "flips":
            for _ in range(chance.randrange(1, 200)):
                data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        case "cut":
            del data[chance.randrange(len(data)) :]
        case "zeros":
            first = chance.randrange(len(data))
            data[first : first + 1024] = bytes(len(data[first : first + 1024]))
        case "swap":
            one, other = (chance.randrange(len(data) // 1024) * 1024 for _ in range(2))
            data[one : one + 1024], data[other : other + 1024] = data[other : other + 1024], data[one : one + 1024]
    return bytes(data)


@pytest.mark.parametrize("seed", range(60))
def test_of_a_damaged_file_only_true_past_states_come_back(made, tmp_path, seed) -> None:
    """Cut, bits flipped, pages lost or confused; what is wrong is set aside as it is, and all goes on."""
    folder, history = made
    chance = random.Random(seed)
    state = tmp_path / "state"
    shutil.copytree(folder / chance.choice(["killed", "ended"]), state)
    victim = chance.choice(
        [path for path in state.glob("r1.sqlite*") if path.suffix != ".sqlite-shm" and path.stat().st_size]
    )
    victim.write_bytes(damage(chance, victim.read_bytes()))
    if chance.random() < 0.5:
        (state / "r1.sqlite-shm").unlink(missing_ok=True)  # as after a restart of the computer
    before = {path.name: path.read_bytes() for path in state.glob("r1.sqlite*")}
    swarm = Swarm(state)
    node = swarm.join("r1", Body(3, 5))
    for session, replica in node.peer.replicas.items():
        assert history[session][replica.state.n] in {map_digest(replica.state.cells), b""}
        assert replica.state.n or not replica.state.cells
    told = node.summary()["state"]
    if told["set_aside"]:
        (aside,) = told["set_aside"]
        assert Path(aside).read_bytes() == before["r1.sqlite"]
        assert "damaged" in told["status"]
    elif told["status"]:  # what is no state file any more is not touched
        assert (state / "r1.sqlite").read_bytes() == before["r1.sqlite"]
    swarm.until(lambda: node.status()["done"])
    swarm.run(20)
    whole = node.peer.fusion.digest()
    swarm.crash()
    if told["set_aside"] or not told["status"]:
        assert swarm.join("r1", Body(4, 0)).peer.fusion.digest() == whole
        swarm.crash()


def test_a_damaged_file_is_said_set_aside_and_what_proved_true_is_kept(made, tmp_path) -> None:
    folder, _ = made
    shutil.copytree(folder / "ended", tmp_path, dirs_exist_ok=True)
    with sqlite3.connect(tmp_path / "r1.sqlite") as db:
        db.execute("UPDATE tile SET version = version - 1 WHERE session >= ? AND version > 1", (b"r2.",))
    db.close()
    for k in (1, 2):
        swarm = Swarm(tmp_path)
        told = swarm.join("r1", Body(3, 0)).summary()["state"]
        swarm.crash()
        if k == 1:
            assert "session 72322e" in told["status"]
            assert "is left out" in told["status"]
            assert "set aside as r1.sqlite.damaged-1" in told["status"]
            assert told["restored"] == {"sessions": 1, "updates": 70}
        else:
            assert (told["status"], told["set_aside"]) == ("", [])


# --- any trouble with the place


def test_a_full_disk_is_said_and_kept_up_with_when_there_is_room(swarm) -> None:
    body = Body(1, 400)
    robot = swarm.join("r1", body)
    swarm.run(5)
    disk = swarm._keepers["r1"]._file._db
    disk.execute("PRAGMA max_page_count = 1")  # SQLite makes it as many as there are
    swarm.until(lambda: "database or disk is full" in robot.status()["state"])
    assert "kept in memory only" in robot.status()["state"]
    swarm.until(lambda: body.done)  # it goes on
    disk.execute("PRAGMA max_page_count = 1000000")
    swarm.until(lambda: "is written again" in robot.status()["state"])
    swarm.crash()
    assert swarm.join("r1", Body(2, 0)).peer.fusion.digest() == digest_of(body.map(ORIGIN))


def test_a_file_that_turns_out_damaged_while_it_is_written_is_begun_anew(swarm) -> None:
    body = Body(1, 400)
    robot = swarm.join("r1", body)
    swarm.run(50)
    path = swarm.folder / "r1.sqlite"
    disk = swarm._keepers["r1"]._file._db
    disk.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    path.write_bytes(path.read_bytes()[:2048] + b"\xff" * 100_000)
    disk.execute("PRAGMA shrink_memory")  # it has to look at the disk again
    swarm.until(lambda: "set aside" in robot.status()["state"])
    swarm.until(lambda: body.done and "is written again" in robot.status()["state"])
    swarm.run(200)
    swarm.crash()
    assert swarm.join("r1", Body(2, 0)).peer.fusion.digest() == digest_of(body.map(ORIGIN))


def of_another_program(path: Path) -> None:
    with sqlite3.connect(path) as db:
        db.execute("CREATE TABLE recipes (name TEXT)")
    db.close()


def of_another(swarm: str, rules: Rules) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        keeper = Keeper(path.parent, "r1", swarm, rules)
        Node(Network(seed=1).bus("r1"), rules, Hello(Hello.ROBOT, b"r1", b"t"), now=0.0, keeper=keeper)
        keeper.close()

    return make


def of_a_later_format(path: Path) -> None:
    of_another(SWARM, RULES)(path)
    with sqlite3.connect(path) as db:
        db.execute("PRAGMA user_version = 99")
    db.close()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda path: path.write_text("my shopping list\n" * 99), "is no state file"),
        (of_another_program, "is another program's database"),
        (of_a_later_format, "has format 99, this program knows format 1"),
        (of_another("garden", RULES), "belongs to swarm 'garden', ours is 'test'"),
        (of_another(SWARM, Rules(Lattice(20), EvidenceModel())), "holds a map with cell size 0.02 m, ours is 0.05 m"),
        (Path.mkdir, "is no file"),
    ],
)
def test_what_is_not_ours_is_not_touched_and_the_swarm_goes_on(swarm, make, said) -> None:
    path = swarm.folder / "r1.sqlite"
    make(path)
    before = path.read_bytes() if path.is_file() else None
    body = Body(1, 30)
    robot = swarm.join("r1", body)
    swarm.until(lambda: robot.status()["done"])
    assert f"{path}: {said}" in robot.status()["state"]
    assert "give another --state" in robot.status()["state"]
    robot._keeper.keep_all(robot.peer, [])
    assert (path.read_bytes() if path.is_file() else None) == before
    assert robot.peer.fusion.digest() == digest_of(body.map(ORIGIN))


def test_a_folder_that_cannot_be_made_is_the_users_to_mend(tmp_path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(UserError, match="choose another --state"):
        Keeper(tmp_path / "file" / "state", "r1", SWARM, RULES)


def test_a_second_process_is_refused_by_name(tmp_path) -> None:
    first = Keeper(tmp_path, "r1", SWARM, RULES)
    with pytest.raises(UserError, match=r"r1\.lock: is held by process \d+"):
        Keeper(tmp_path, "r1", SWARM, RULES)
    Keeper(tmp_path, "r2", SWARM, RULES).close()
    first.close()
    Keeper(tmp_path, "r1", SWARM, RULES).close()
