import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from swarm import parts
from swarm.drops import Drop
from swarm.limits import MAX_PARTS, MIN_MTU
from swarm.messages import Part, Session, TilesMessage, decode, encode
from swarm.parts import Joiner, cut


def long_message(size, fill=7):
    return TilesMessage(bytes(8), bytes([fill]) * size)


def join_all(joiner, payloads):
    """What a joiner gives for each of some parts."""
    return [whole for payload in payloads if (whole := joiner.join(decode(payload))) is not None]


@settings(max_examples=50)
@given(st.integers(200, 5000), st.integers(MIN_MTU, 150), st.randoms(use_true_random=False))
def test_parts_in_any_order_and_repeated_give_the_message_once(size, mtu, chance):
    message = long_message(size)
    payloads = cut(encode(message), mtu)
    assert max(map(len, payloads)) <= mtu
    last = payloads.pop(chance.randrange(len(payloads)))
    some = payloads * 2
    chance.shuffle(some)
    joiner = Joiner()
    assert join_all(joiner, some) == []
    assert join_all(joiner, [last]) == [message]


def test_a_short_message_is_not_cut():
    wire = encode(long_message(60))
    assert cut(wire, len(wire)) == [wire]
    assert len(cut(wire + bytes(30), len(wire) + 29)) == 2


@pytest.mark.parametrize("mtu", [MIN_MTU, 300, 40_000, 70_000])
def test_a_part_never_exceeds_the_mtu(mtu):
    """Also where numbers and lengths take their longest form."""
    piece = Part(b"12345678", MAX_PARTS - 1, MAX_PARTS, b"x" * (mtu - parts._OVERHEAD))
    assert len(encode(piece)) <= mtu


def test_messages_that_interleave_both_arrive():
    one, other = long_message(500, 1), long_message(500, 2)
    mixed = [each for pair in zip(cut(encode(one), 100), cut(encode(other), 100), strict=True) for each in pair]
    assert join_all(Joiner(), mixed) == [one, other]


def test_a_message_that_would_take_too_many_parts_is_our_mistake():
    with pytest.raises(ValueError, match="too many parts"):
        cut(bytes(40 * MAX_PARTS), MIN_MTU)


def test_a_part_beyond_the_last_leaves_nothing_behind():
    """Each used to leave an empty entry that never made room for another: memory without end."""
    joiner = Joiner()
    for k in range(100):
        with pytest.raises(Drop, match="parts"):
            joiner.join(Part(k.to_bytes(8, "little"), 5, 5, b"x"))
    assert not joiner._unfinished


def test_parts_that_do_not_make_up_their_name_are_dropped_and_forgotten():
    joiner = Joiner()
    first, second, *_ = (decode(payload) for payload in cut(encode(long_message(90)), 100))
    joiner.join(first)
    with pytest.raises(Drop, match="parts"):
        joiner.join(Part(second.digest, 1, 2, b"something else"))
    assert not joiner._unfinished
    assert joiner.join(first) is None
    assert joiner.join(second) == long_message(90)


def test_a_part_within_parts_is_dropped():
    inner = encode(Part(bytes(8), 0, 2, bytes(200)))
    first, *others = cut(inner, 100)
    joiner = Joiner()
    joiner.join(decode(first))
    with pytest.raises(Drop, match="parts"):
        join_all(joiner, others)


def test_parts_of_garbage_are_dropped_for_what_the_whole_is():
    joiner = Joiner()
    with pytest.raises(Drop, match="msgpack"):
        join_all(joiner, cut(b"\xc1" * 200, 100))


def test_what_is_never_finished_makes_room(monkeypatch):
    monkeypatch.setattr(parts, "MAX_PART_BYTES", 2000)
    joiner = Joiner()
    for k in range(50):
        joiner.join(Part(k.to_bytes(8, "little"), 0, 2, bytes(100)))
        assert joiner._bytes <= 2000
    assert len(joiner._unfinished) == 6
    assert join_all(joiner, cut(encode(long_message(300)), 200)) == [long_message(300)]
    assert joiner._bytes == sum(
        len(data) + parts._KEEPING for pieces in joiner._unfinished.values() for data in pieces.values()
    )


def test_a_message_longer_than_any_may_be_is_dropped(monkeypatch):
    monkeypatch.setattr(parts, "MAX_MESSAGE", 100)
    with pytest.raises(Drop, match="parts"):
        join_all(Joiner(), cut(encode(Session(bytes(200))), 80))
