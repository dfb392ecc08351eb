"""The swarm's TOML: every rule has its line for the user, and nothing that is written in it is ever a traceback."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import example, given
from hypothesis import strategies as st

from agent.config import Config, RecordedBody, SerialBody, SimulatedNoise, Simulation, load, resolve
from agent.errors import UserError
from agent.senses import NO_NOISE, ORION_NOISE
from mapping.lattice import MAX_RAY_CELLS
from mapping.pose import QuantisedPose
from mapping.sensor import orion


@pytest.fixture
def complaint(tmp_path: Path):
    """What is said of a TOML, without the file's name in front."""

    def complain(text: str | bytes) -> str:
        file = tmp_path / "lab.toml"
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(UserError) as caught:
            load(file, {}, {})
        said = str(caught.value)
        assert said.startswith(f"{file}: ")
        assert len(said.splitlines()) == 1
        return said.removeprefix(f"{file}: ")

    return complain


# What is set, and by whom


def test_without_any_file_the_defaults_hold() -> None:
    config = load(None, {}, {})
    assert config == Config()
    assert (config.swarm, config.cell, config.transport, config.base_port, config.radio, config.publish) == (
        "orion",
        0.02,
        "zenoh",
        7450,
        "lan",
        "auto",
    )
    assert config.sensor.build() == orion()
    rules = config.rules()
    assert rules.lattice.cell_mm == 20
    assert (rules.model.occupied, rules.model.free, rules.model.limit) == (85, -40, 0)
    assert config.roster == []


def test_an_option_comes_before_the_environment_before_the_file_before_the_default(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text("cell = 0.1\nbase_port = 8000\nswarm = 'lab'\n")
    environment = {"ORION_CELL": "0.2", "ORION_BASE_PORT": "9000", "ORION_DATA": "/elsewhere"}
    config = load(file, {"cell": 0.4, "base_port": None}, environment)
    assert (config.cell, config.base_port, config.swarm, config.publish) == (0.4, 9000, "lab", "auto")


def test_what_is_wrong_is_laid_to_where_it_was_set(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text("radio = 'lan'\n")
    with pytest.raises(UserError, match=r"^ORION_BASE_PORT: base_port: input should be a valid integer"):
        load(file, {}, {"ORION_BASE_PORT": "many"})
    with pytest.raises(UserError, match=r"^--base-port: base_port: input should be less than or equal to 65535"):
        load(file, {"base_port": 70_000}, {})
    with pytest.raises(UserError, match=r"^--radio: radio: input should be 'lan', .* or 'digimesh-6hop', got 'loud'"):
        load(file, {"radio": "loud"}, {})


def test_a_whole_configuration_is_understood(tmp_path: Path) -> None:
    file = tmp_path / "lab.toml"
    file.write_text("""
        swarm = "lab"
        cell = 0.05
        publish = "scans"
        [evidence]
        occupied = 1.2
        free = -0.3
        limit = 20
        [sensor]
        kind = "laser"
        beams = 181
        first_deg = -90
        step_deg = 1
        max_range = 8
        [simulation]
        world = "rooms"
        seed = 3
        speed = "max"
        noise = {slip = 0.1}
        [robots.r2]
        host = "10.0.0.2"
        start = {x = 2.150, y = 1.450, yaw_deg = 10.0}
        publish = "tiles"
        body = {kind = "serial", port = "/dev/ttyACM0", baudrate = 57600, waypoints = [[1, 2.5]]}
        [robots.r1]
        body = {kind = "recording", path = "/data/run.log", part = 2, parts = 3, poses = "slam", speed = 4}
    """)
    config = load(file, {}, {})
    assert config.roster == ["r2", "r1"]  # the file's order gives the ports
    assert config.hosts == ["10.0.0.2", "127.0.0.1"]
    assert (config.rules().model.occupied, config.rules().model.free, config.rules().model.limit) == (120, -30, 2000)
    assert len(config.sensor.build().beams) == 181
    start = config.robots["r2"].start
    assert start is not None
    assert start.quantised() == QuantisedPose(2150, 1450, round(10 / 360 * 65536))
    assert config.robots["r1"].start is None
    assert config.robots["r2"].body == SerialBody(
        kind="serial", port="/dev/ttyACM0", baudrate=57_600, max_range=0.8, drive=True, waypoints=[(1.0, 2.5)]
    )
    assert config.simulation == Simulation(world="rooms", seed=3, speed="max", noise=SimulatedNoise(slip=0.1))
    body = config.robots["r1"].body
    assert isinstance(body, RecordedBody)
    assert (body.part, body.parts, body.poses, body.speed) == (2, 3, "slam", 4.0)


def test_paths_are_relative_to_the_file_that_names_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "lab.toml").write_text("""
        [robots.r1.body]
        kind = "recording"
        path = "logs/run.log"
        [robots.r2.body]
        kind = "serial"
        port = "r2.tty"
        [robots.r3.body]
        kind = "serial"
        port = "socket://10.0.0.3:9000"
        [robots.r4.body]
        kind = "recording"
        path = "/data/run.log"
        [robots.r5.body]
        kind = "serial"
        port = "/dev/ttyACM0"
    """)
    monkeypatch.chdir(tmp_path)
    bodies = [robot.body for robot in load(Path("sub/lab.toml"), {}, {}).robots.values()]
    assert [getattr(body, "path", None) or getattr(body, "port", None) for body in bodies] == [
        str(tmp_path / "sub" / "logs" / "run.log"),
        str(tmp_path / "sub" / "r2.tty"),
        "socket://10.0.0.3:9000",
        "/data/run.log",
        "/dev/ttyACM0",
    ]


@pytest.mark.parametrize(
    ("world", "found"), [("mine.yaml", "sub/mine.yaml"), ("../w/x", "sub/../w/x"), ("rooms", None)]
)
def test_a_worlds_file_is_relative_to_the_file_that_names_it(tmp_path: Path, world: str, found: str | None) -> None:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "lab.toml").write_text(f"[simulation]\nworld = '{world}'\n")
    simulation = load(tmp_path / "sub" / "lab.toml", {}, {}).simulation
    assert simulation.world == (str(tmp_path / found) if found else world)


def test_the_simulations_noise_is_that_of_a_well_kept_orion_unless_told_otherwise() -> None:
    assert Simulation().build_noise() == ORION_NOISE
    assert Simulation(ideal=True, noise=SimulatedNoise(slip=0.5)).build_noise() == NO_NOISE
    assert resolve({"simulation": {"noise": {"heading_deg": 180}}}).simulation.build_noise().heading == math.pi


# What is wrong


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("cel = 0.05", "cel: is no key of the configuration; did you mean cell?"),
        ("[evidence]\noccupid = 1", "evidence.occupid: is no key of the configuration; did you mean occupied?"),
        (
            "[sensor]\nkind = 'orion'\nmaxrange = 1",
            "sensor.maxrange: is no key of the configuration; did you mean max_range?",
        ),
        (
            "[sensor]\nkind = 'laser'\nbeam = 1",
            "sensor.beam: is no key of the configuration; did you mean beams?",
        ),
        (
            "[sensor]\nkind = 'beams'\nmax_range = 1.0\nbeams = [{baering_deg = 3.0}]",
            "sensor.beams.0.baering_deg: is no key of the configuration; did you mean bearing_deg?",
        ),
        ("[observers.b]\nhots = 'a'", "observers.b.hots: is no key of the configuration; did you mean host?"),
        ("[robots.b]\n[observers.b]", "observers: b is a robot's name"),
        ("[robots.r1]\nhots = 'a'", "robots.r1.hots: is no key of the configuration; did you mean host?"),
        ("[robots.r1.start]\nyaw = 90", "robots.r1.start.yaw: is no key of the configuration; did you mean yaw_deg?"),
        (
            "[robots.r1.body]\nkind = 'serial'\nport = 'a'\nbaudrat = 2",
            "robots.r1.body.baudrat: is no key of the configuration; did you mean baudrate?",
        ),
        ("[simulation]\nsped = 2", "simulation.sped: is no key of the configuration; did you mean speed?"),
        (
            "[simulation.noise]\ndrop_out = 0.1",
            "simulation.noise.drop_out: is no key of the configuration; did you mean dropout?",
        ),
        (
            "[robots.r1.body]\nkind = 'recording'\npaht = 'run.log'",  # path is missing too, and that says less
            "robots.r1.body.paht: is no key of the configuration; did you mean path?",
        ),
        (
            "zzz = 1",
            "zzz: is no key of the configuration; known here: base_port, cell, evidence, observers, publish, radio, ",
        ),
    ],
)
def test_an_unknown_key_at_any_level_names_the_nearest_known_one(complaint, text: str, said: str) -> None:
    assert complaint(text).startswith(said)


@pytest.mark.parametrize("name", ["orion", "laser", "beams", "serial", "recording", "sensor", "robots", "start"])
def test_a_robot_may_be_called_like_a_kind_of_thing(complaint, name: str) -> None:
    """Once the robot called orion vanished from the message: "robots.hots"."""
    assert complaint(f"[robots.{name}]\nhots = 'a'").startswith(f"robots.{name}.hots: is no key")
    assert complaint(f"[robots.{name}.start]\nx = nan").startswith(f"robots.{name}.start.x: ")
    assert complaint(f"[robots.{name}.body]\nkind = 'serial'\nprot = 'a'").endswith("did you mean port?")


def test_a_robot_that_is_declared_twice_is_named(complaint) -> None:
    said = complaint("[robots.r1]\n[robots.r2]\n[robots.r1]\n")
    assert "'r1') twice (at line 3" in said
    assert "each robot and key may appear once" in said


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "1e308", "-1e7", "10" + "0" * 400])
@pytest.mark.parametrize("key", ["x", "y", "yaw_deg"])
def test_a_start_that_no_robot_has_is_refused(complaint, key: str, number: str) -> None:
    """A heading of 1e308 degrees once reached the agents, which died of an OverflowError."""
    assert complaint(f"[robots.r1]\nstart = {{{key} = {number}}}").startswith(f"robots.r1.start.{key}: ")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("cell = 0.0205", "cell: 0.0205 m is not a whole number of millimetres"),
        ("cell = 0", "cell: input should be greater than 0, got 0"),
        ("cell = 11", "cell: 11.0 m, expected 0.001 to 10 m"),
        ("cell = nan", "cell: input should be a finite number"),
        ("swarm = ''", "swarm: a swarm's name is 1 to 64 letters"),
        ("swarm = 'a/b'", "swarm: a swarm's name is 1 to 64 letters"),
        ("transport = 'pigeon'", "transport: input should be 'zenoh' or 'zmq', got 'pigeon'"),
        ("base_port = 0", "base_port: input should be greater than or equal to 1"),
        ("base_port = 65535\n[robots.r1]\n[robots.r2]", "base_port: 65535 leaves no ports for 2 peers"),
        ("publish = 'loud'", "publish: input should be 'auto', 'scans' or 'tiles', got 'loud'"),
        ("[evidence]\noccupied = -1", "evidence.occupied: input should be greater than 0"),
        ("[evidence]\noccupied = 0.001", "evidence: occupied is 0, expected 1 to 10000 units"),
        ("[evidence]\nfree = 0.4", "evidence.free: input should be less than 0"),
        ("[evidence]\nlimit = -1", "evidence.limit: input should be greater than or equal to 0"),
        ("[sensor]\nkind = 'nose'", "sensor.kind: 'nose' is unknown; give orion, laser or beams"),
        ("[sensor]\nmax_range = 1", "sensor.kind: is missing; give orion, laser or beams"),
        ("[sensor]\nkind = 'orion'\nmax_range = 66", "sensor.max_range: input should be less than or equal to 65"),
        ("[sensor]\nkind = 'laser'\nbeams = 3\nfirst_deg = 1e308\nstep_deg = 1", "sensor.first_deg: input should be"),
        ("[sensor]\nkind = 'beams'\nmax_range = 1\nbeams = []", "sensor.beams: list should have at least 1 item"),
        ("[sensor]\nkind = 'beams'\nmax_range = 1\nbeams = [{x = 1e300, bearing_deg = 0}]", "sensor.beams.0.x: input"),
        ("[robots.'a b']", "robots.a b: a robot id is 1 to 32 letters"),
        ("[robots._a]", "robots._a: a robot id is 1 to 32 letters"),
        ("[robots.observer]", "robots.observer: no robot is called observer"),
        ("[robots.r1]\nhost = ''", "robots.r1.host: a host is a name or an address"),
        ("[robots.r1]\nhost = '10.0.0.1:7450'", "robots.r1.host: a host is a name or an address"),
        ("[robots.r1]\nhost = '10.0.0.1#iface=eth0'", "robots.r1.host: a host is a name or an address"),
        ("[robots.r1.body]\nkind = 'ghost'", "robots.r1.body.kind: 'ghost' is unknown; give serial, recording or log"),
        ("[robots.r1.body]\nspeed = 1", "robots.r1.body.kind: is missing; give serial, recording or log"),
        ("[robots.r1.body]\nkind = 'recording'", "robots.r1.body.path: field required"),
        (
            "[robots.r1.body]\nkind = 'simulated'",
            "robots.r1.body.kind: 'simulated' is unknown; give serial, recording or log",
        ),
        ("[robots.r1.body]\nkind = 'serial'", "robots.r1.body.port: field required"),
        ("[robots.r1.body]\nkind = 'serial'\nport = ''", "robots.r1.body.port: string should have at least 1"),
        ("[robots.r1.body]\nkind = 'serial'\nport = 'a'\nbaudrate = 0", "robots.r1.body.baudrate: input should be"),
        ("[robots.r1.body]\nkind = 'serial'\nport = 'a'\nwaypoints = [[nan, 1]]", "robots.r1.body.waypoints.0.0: in"),
        ("[robots.r1.body]\nkind = 'serial'\nport = 'a'\nwaypoints = [[1]]", "robots.r1.body.waypoints.0.1: field r"),
        ("[simulation]\nseed = -1", "simulation.seed: input should be"),
        ("[simulation]\nspeed = 'fast'", "simulation.speed."),
        ("[simulation.noise]\ndropout = 1.5", "simulation.noise.dropout: input should be less than or equal to 1"),
        ("[simulation.noise]\nheading_drift_time = 0", "simulation.noise.heading_drift_time: input should be"),
        ("[robots.r1.body]\nkind = 'recording'\npath = 'a'\npart = 0", "robots.r1.body.part: input should be"),
        ("robots = 3", "robots: input should be a valid dictionary, got 3"),
        ('"ce\\nll" = 3', "ce\\nll: is no key of the configuration; did you mean cell?"),
        ("cell = ", "is no TOML: "),
        (b"cell = \xff", "is no TOML: "),
        ("a = " + "[" * 5000, "is no TOML: "),
        ("cell = " + "9" * 5000, "is no TOML: "),
    ],
)
def test_a_bad_value_is_named_with_its_key(complaint, text: str | bytes, said: str) -> None:
    assert complaint(text).startswith(said)


@pytest.mark.parametrize("host", ["robot-1.local", "10.0.0.1", "::1", "fe80::1%eth0", "r_1"])
def test_hosts_are_names_and_addresses(host: str) -> None:
    assert resolve({"robots": {"r1": {"host": host}}}).hosts == [host]


@given(cell_mm=st.integers(1, 30))
def test_a_range_of_more_than_4095_cells_is_refused(cell_mm: int) -> None:
    def with_range(millimetres: int) -> Config:
        return resolve({"cell": cell_mm / 1000, "sensor": {"kind": "orion", "max_range": millimetres / 1000}})

    longest = min(65_000, MAX_RAY_CELLS * cell_mm)
    assert with_range(longest).sensor.max_range == longest / 1000
    with pytest.raises(UserError, match=r"more than 4095 cells|less than or equal to 65"):
        with_range(longest + 1)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"none\.toml: cannot be read: No such file or directory; check the path"):
        load(tmp_path / "none.toml", {}, {})
    with pytest.raises(UserError, match=r"cannot be read: Is a directory"):
        load(tmp_path, {}, {})


# Any configuration, and any text

NAMES = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_-]{0,8}", fullmatch=True).filter(lambda name: name != "observer")
DEGREES = st.floats(-36_000, 36_000)
SPEEDS = st.floats(1e-3, 1e6) | st.just("max")
RANGES = st.floats(0.01, 3.0)
METRES = st.floats(-8e5, 8e5)
BODIES = st.fixed_dictionaries(
    {"kind": st.just("serial"), "port": st.text(st.characters(exclude_categories=["Cs"]), min_size=1)},
    optional={
        "baudrate": st.integers(300, 4_000_000),
        "max_range": RANGES,
        "drive": st.booleans(),
        "waypoints": st.lists(st.tuples(METRES, METRES).map(list), max_size=3),
    },
) | st.fixed_dictionaries(
    {"kind": st.just("recording"), "path": st.text(st.characters(exclude_categories=["Cs"]))},
    optional={
        "robot": st.integers(0, 9),
        "part": st.integers(1, 9),
        "parts": st.integers(1, 9),
        "poses": st.sampled_from(["truth", "odometry", "slam"]),
        "max_range": RANGES,
        "speed": SPEEDS,
    },
)
ROBOTS = st.fixed_dictionaries(
    {},
    optional={
        "host": st.sampled_from(["127.0.0.1", "::1", "robot.local"]),
        "start": st.fixed_dictionaries({}, optional={"x": METRES, "y": METRES, "yaw_deg": DEGREES}),
        "publish": st.sampled_from(["auto", "scans", "tiles"]),
        "body": BODIES,
    },
)
SENSORS = (
    st.fixed_dictionaries({}, optional={"kind": st.just("orion"), "max_range": RANGES}).map(
        lambda s: {"kind": "orion"} | s
    )
    | st.fixed_dictionaries(
        {
            "kind": st.just("laser"),
            "beams": st.integers(1, 9),
            "first_deg": DEGREES,
            "step_deg": DEGREES,
            "max_range": RANGES,  # its default, 20 m, is too far for cells of less than 5 mm
        }
    )
    | st.fixed_dictionaries(
        {
            "kind": st.just("beams"),
            "max_range": RANGES,
            "beams": st.lists(
                st.fixed_dictionaries({"bearing_deg": DEGREES}, optional={"x": st.floats(-32, 32)}),
                min_size=1,
                max_size=3,
            ),
        }
    )
)
SIMULATIONS = st.fixed_dictionaries(
    {},
    optional={
        "world": st.text(st.characters(exclude_categories=["Cs"])),
        "seed": st.integers(0, 2**70),
        "speed": SPEEDS,
        "ideal": st.booleans(),
        "noise": st.fixed_dictionaries({}, optional={"dropout": st.floats(0, 1), "slip": st.floats(0, 0.9)}),
    },
)
CONFIGS = st.fixed_dictionaries(
    {},
    optional={
        "swarm": st.from_regex(r"[A-Za-z0-9._-]{1,64}", fullmatch=True),
        "cell": st.integers(1, 10_000).map(lambda millimetres: millimetres / 1000),
        "base_port": st.integers(1, 65_000),
        "publish": st.sampled_from(["auto", "scans", "tiles"]),
        "evidence": st.fixed_dictionaries({}, optional={"occupied": st.floats(0.01, 100), "limit": st.floats(0, 100)}),
        "sensor": SENSORS,
        "simulation": SIMULATIONS,
        "robots": st.dictionaries(NAMES, ROBOTS, max_size=4),
    },
)


@given(CONFIGS)
def test_the_resolved_configuration_loads_again_as_itself(table: dict[str, Any]) -> None:
    config = resolve(table)
    config.sensor.build()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "orion.toml"
        file.write_bytes(config.toml())
        again = load(file, {}, {})
        # Paths in a file are relative to it; a resolved configuration of a run has absolute ones only.
        anchored = Path(folder) / "once.toml"
        anchored.write_bytes(again.toml())
        assert load(anchored, {}, {}) == again
    paths = {"robots": {robot: {"body"} for robot in config.robots}, "simulation": {"world"}}
    assert again.model_dump(exclude=paths) == config.model_dump(exclude=paths)
    assert again.roster == config.roster


def load_or_complain(file: Path | None, environment: dict[str, str]) -> Config | None:
    """The configuration, or None after a complaint of one line; anything else is raised."""
    config, said = None, ""
    try:
        config = load(file, {}, environment)
    except UserError as error:
        said = str(error)
    assert said.isprintable()
    return config


JUNK = st.recursive(
    st.none().map(lambda _: "x")
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(st.characters(exclude_categories=["Cs"]), max_size=9)
    | st.datetimes()
    | st.sampled_from(["orion", "laser", "beams", "serial", "recording", 1e308, -1e308, 10**400, math.nan]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)
KEYS = ("swarm", "cell", "base_port", "evidence", "sensor", "robots", "kind", "beams", "max_range", "first_deg", "r1")
KEYS += ("step_deg", "bearing_deg", "x", "start", "yaw_deg", "body", "path", "world", "speed", "host", "seed", "free")
KEYS += ("simulation", "noise", "port", "waypoints", "drive", "dropout")


@given(
    st.recursive(
        st.dictionaries(st.sampled_from(KEYS), JUNK, max_size=5),
        lambda inner: st.dictionaries(st.sampled_from(KEYS), inner | JUNK | st.lists(inner, max_size=2), max_size=5),
    )
)
@example({"sensor": {"kind": "laser", "beams": 2, "first_deg": 0.0, "step_deg": 1e308}})
@example({"robots": {"r1": {"start": {"yaw_deg": 1e308}}}})
def test_whatever_a_toml_holds_is_a_configuration_or_one_line(table: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "any.toml"
        try:
            file.write_text(tomli_w.dumps(table), newline="")
        except UnicodeEncodeError:
            return
        config = load_or_complain(file, {})
        if config is None:
            return
        config.toml()
        config.rules()
        for robot in config.robots.values():
            assert robot.start is None or robot.start.quantised() is not None


@given(st.text() | st.text("[]{}=.\"'#\n\r\\ abcell0123:,-_") | st.binary().map(lambda data: data.decode("latin-1")))
def test_whatever_text_is_given_for_a_toml_is_a_configuration_or_one_line(text: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "any.toml"
        file.write_bytes(text.encode("utf-8", "surrogatepass"))
        load_or_complain(file, {})


@given(st.dictionaries(st.sampled_from(["ORION_CELL", "ORION_SWARM", "ORION_BASE_PORT", "ORION_RADIO"]), st.text()))
def test_whatever_the_environment_holds_is_a_configuration_or_one_line(environment: dict[str, str]) -> None:
    load_or_complain(None, environment)
