import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.evidence import EvidenceModel
from mapping.lattice import Lattice
from mapping.pose import QuantisedPose
from mapping.sensor import Beam, Sensor, orion
from swarm.drops import Drop
from swarm.limits import MAX_COORDINATE_MM
from swarm.session import Descriptor, Rules, refusal

small = st.integers(-32767, 32767)
angle = st.integers(0, 65535)
place = st.integers(-MAX_COORDINATE_MM, MAX_COORDINATE_MM)
models = st.builds(EvidenceModel, st.integers(1, 10_000), st.integers(-10_000, -1), st.integers(0, 10_000))
beams = st.lists(st.builds(Beam, small, small, angle, st.integers(0, 3276)), min_size=1, max_size=20).map(tuple)


@st.composite
def descriptors(draw):
    cell = draw(st.integers(1, 10_000))
    return Descriptor(
        draw(st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}", fullmatch=True)),
        draw(st.binary(min_size=8, max_size=8)),
        Rules(Lattice(cell), draw(models)),
        Sensor(draw(beams), draw(st.integers(1, min(65_000, 4095 * cell)))),
        draw(st.none() | st.builds(QuantisedPose, place, place, angle)),
        draw(st.none() | st.just(b"replaced")),
    )


RULES = Rules(Lattice(50), EvidenceModel())
PLAIN = Descriptor("r1", bytes(range(8)), RULES, orion(), QuantisedPose(1, -2, 3))


@given(descriptors())
def test_decode_after_encode_is_identity(descriptor):
    data = descriptor.encode()
    assert Descriptor.decode(data) == descriptor
    assert Descriptor.decode(data).encode() == data


@given(descriptors())
def test_the_plain_client_reads_the_same(plain_client, descriptor):
    found = plain_client.decode_descriptor(descriptor.encode())
    assert (found.robot, found.session, found.start) == (descriptor.robot, descriptor.session, descriptor.start)
    assert found.replaces == descriptor.replaces
    assert found.beams == [tuple(beam) for beam in descriptor.sensor.beams]


def decode_or_none(data):
    try:
        return Descriptor.decode(data)
    except Drop:
        return None


@given(descriptors(), st.data())
def test_a_changed_descriptor_is_another_one_or_dropped(descriptor, data):
    wire = bytearray(descriptor.encode())
    wire[data.draw(st.integers(0, len(wire) - 1))] ^= data.draw(st.integers(1, 255))
    found = decode_or_none(bytes(wire))
    if found is not None:
        assert found != descriptor
        assert found.encode() == wire


@given(st.binary(max_size=100))
def test_garbage_is_dropped(garbage):
    with pytest.raises(Drop, match="descriptor"):
        Descriptor.decode(garbage)


FIELDS = msgpack.unpackb(PLAIN.encode())


@pytest.mark.parametrize(
    ("index", "value"),
    [
        (0, b""),
        (0, b"-r"),
        (0, b"a" * 33),
        (0, "r1"),
        (0, "ü".encode()),
        (1, bytes(7)),
        (1, "12345678"),
        (2, 0),
        (2, 10_001),
        (2, 50.0),
        (2, True),
        (3, 0),
        (3, 10_001),
        (4, 0),
        (4, -10_001),
        (5, -1),
        (6, 1),
        (6, False),
        (7, 0),
        (7, 65_001),
        (8, b""),
        (8, bytes(9)),
        (8, bytes(8 * 4097)),
        (8, b"\0\0\0\0\0\0\1\x40"),  # wider than half a turn
        (8, b"\0\0\0\0\0\0\0\x40" * 5),  # two and a half turns of view
        (8, b"\0\x80\0\0\0\0\0\0"),
        (9, bytes(9)),
        (9, (MAX_COORDINATE_MM + 1).to_bytes(4, "little") + bytes(6)),
        (9, None),
        (10, bytes(7)),
        (10, bytes(range(8))),  # itself
        (10, None),
    ],
)
def test_a_field_outside_its_limits_drops_the_whole(index, value):
    with pytest.raises(Drop, match="descriptor"):
        Descriptor.decode(msgpack.packb([*FIELDS[:index], value, *FIELDS[index + 1 :]]))


def test_a_longer_form_of_the_same_descriptor_is_dropped():
    data = PLAIN.encode()
    at = data.index(bytes([50]), 14)
    assert Descriptor.decode(data) == PLAIN
    with pytest.raises(Drop):
        Descriptor.decode(data[:at] + bytes([0xCC, 50]) + data[at + 1 :])
    with pytest.raises(Drop):
        Descriptor.decode(data + b"\0")


def test_a_range_of_more_than_4095_cells_is_refused():
    with pytest.raises(ValueError, match="4095 cells"):
        Descriptor("r1", bytes(8), Rules(Lattice(1), EvidenceModel()), orion(4.2), None)


def test_a_bad_name_or_session_id_is_our_mistake():
    with pytest.raises(ValueError, match="robot id"):
        Descriptor("r 1", bytes(8), RULES, orion(), None)
    with pytest.raises(ValueError, match="expected 8 bytes"):
        Descriptor("r1", bytes(9), RULES, orion(), None)
    with pytest.raises(ValueError, match="replace: expected 8 bytes"):
        Descriptor("r1", bytes(8), RULES, orion(), None, bytes(7))
    with pytest.raises(ValueError, match="cannot replace itself"):
        Descriptor("r1", bytes(8), RULES, orion(), None, bytes(8))


@pytest.mark.parametrize(
    ("theirs", "words"),
    [
        (RULES, None),
        (Rules(Lattice(20), EvidenceModel()), "cell size 0.02 m, ours is 0.05 m"),
        (Rules(Lattice(50), EvidenceModel(occupied=90)), "evidence occupied 0.9 nat, ours is 0.85 nat"),
        (Rules(Lattice(50), EvidenceModel(free=-41)), "evidence free -0.41 nat, ours is -0.4 nat"),
        (Rules(Lattice(50), EvidenceModel(limit=500)), "evidence limit 5.0 nat, ours is 0.0 nat"),
    ],
)
def test_sessions_of_other_rules_are_refused_in_words(theirs, words):
    assert refusal(RULES, Descriptor("r1", bytes(8), theirs, orion(), None)) == words


def test_another_sensor_is_no_reason_to_refuse():
    assert refusal(RULES, Descriptor("r1", bytes(8), RULES, Sensor((Beam(0, 0, 0),), 30_000), None)) is None
