from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from swarm.outbox import Lane, Outbox
from swarm.radio import LAN, PROFILES

RADIO = replace(PROFILES["digimesh-3hop"], rate=1000.0, burst=0.5, queue=1000)


def said(outbox, now):
    return [each.payload for each in outbox.take(now)]


def drained(outbox, now):
    """All that waits, as time allows: (when, what)."""
    out = []
    while outbox.wake_at < float("inf"):
        now = max(now, outbox.wake_at)
        out += [(now, each) for each in outbox.take(now)]
    return out


def test_a_burst_goes_at_once_and_the_rest_at_the_rate():
    outbox = Outbox(RADIO, 0.0)
    outbox.put(Lane.ANSWERS, "tiles", [bytes([k]) * 100 for k in range(10)], "b")
    assert len(outbox.take(0.0)) == 6  # 500 bytes saved up, and the one that is paid for afterwards
    assert outbox.wake_at == pytest.approx(0.1)
    assert outbox.take(0.05) == []
    assert len(outbox.take(0.1)) == 1


def test_the_channel_is_shared_among_those_who_are_there():
    outbox = Outbox(RADIO, 0.0)
    outbox.among(4, 0.0)
    outbox.put(Lane.ANSWERS, "tiles", [bytes([k]) * 100 for k in range(10)], "b")
    times = [at for at, _ in drained(outbox, 0.0)]
    assert times[-1] == pytest.approx((1000 - 100 - 100) / 200, abs=0.01)


def test_a_lan_is_not_shared_but_a_copy_goes_to_each():
    outbox = Outbox(replace(LAN, rate=1000.0, burst=0.0), 0.0)
    outbox.among(4, 0.0)
    outbox.put(Lane.UPDATES, "update", [bytes(100)])
    assert len(outbox.take(0.0)) == 1
    outbox.put(Lane.UPDATES, "update", [bytes(100)])
    assert outbox.wake_at == pytest.approx(0.4)


@given(st.lists(st.tuples(st.floats(0, 0.4), st.sampled_from(Lane), st.integers(1, 84), st.booleans()), max_size=80))
def test_over_any_window_no_more_is_said_than_the_share_a_burst_and_one_payload(events):
    outbox, now, sent = Outbox(RADIO, 0.0), 0.0, []
    outbox.among(1, 0.0)
    for number, (wait, lane, size, to_all) in enumerate(events):
        now += wait
        outbox.put(lane, "x", [number.to_bytes(2, "big") + bytes(size)], None if to_all else "b")
        sent += [(now, len(each.payload)) for each in outbox.take(now)]
    sent += [(at, len(each.payload)) for at, each in drained(outbox, now)]
    for k, (begin, _) in enumerate(sent):
        total = 0
        for end, size in sent[k:]:
            total += size
            assert total <= 500 * (end - begin) + 250 + 86 + 1


def test_own_updates_go_first_and_then_every_second_turn():
    outbox = Outbox(RADIO, 0.0)
    outbox.put(Lane.ANSWERS, "tiles", [b"a1", b"a2"], "b")
    outbox.put(Lane.DIGESTS, "digest", [b"d"])
    outbox.put(Lane.UPDATES, "update", [b"u1", b"u2", b"u3", b"u4"])
    assert said(outbox, 0.0) == [b"u1", b"d", b"u2", b"a1", b"u3", b"a2", b"u4"]


def test_what_waits_already_is_not_queued_again():
    outbox = Outbox(RADIO, 0.0)
    assert outbox.put(Lane.ANSWERS, "tiles", [b"tile"], "b")
    assert not outbox.put(Lane.ANSWERS, "tiles", [b"tile"], "b")
    assert [(each.to, each.payload) for each in outbox.take(0.0)] == [("b", b"tile")]
    assert outbox.put(Lane.ANSWERS, "tiles", [b"tile"], "b")


def test_what_several_asked_for_is_said_to_all_once_on_a_radio():
    outbox = Outbox(RADIO, 0.0)
    outbox.among(4, 0.0)
    for peer in "bc":
        outbox.put(Lane.ANSWERS, "tiles", [b"tile"], peer)
    assert [each.to for each in outbox.take(0.0)] == [None]


def test_on_a_lan_only_if_all_asked_for_it():
    outbox = Outbox(LAN, 0.0)
    outbox.among(3, 0.0)
    for peer in "bc":
        outbox.put(Lane.ANSWERS, "tiles", [b"tile"], peer)
    assert [each.to for each in outbox.take(0.0)] == ["b", "c"]
    for peer in "bcd":
        outbox.put(Lane.ANSWERS, "tiles", [b"tile"], peer)
    assert [each.to for each in outbox.take(0.0)] == [None]


def test_the_queue_is_bounded_and_what_finds_no_room_is_counted():
    outbox = Outbox(RADIO, 0.0)
    accepted = [outbox.put(Lane.ANSWERS, "tiles", [number.to_bytes(100, "big")], "b") for number in range(20)]
    assert accepted == [True] * 10 + [False] * 10
    assert outbox.refused == 10


def test_what_waits_for_one_that_left_is_not_sent():
    outbox = Outbox(RADIO, 0.0)
    outbox.put(Lane.ANSWERS, "tiles", [b"one"], "b")
    outbox.put(Lane.ANSWERS, "tiles", [b"two"], "b")
    outbox.put(Lane.ANSWERS, "tiles", [b"two"], "c")
    outbox.forget("b")
    assert [(each.to, each.payload) for each in outbox.take(0.0)] == [("c", b"two")]


def test_an_own_update_is_worth_making_only_if_it_goes_at_once():
    outbox = Outbox(RADIO, 0.0)
    assert outbox.ready(0.0)
    outbox.put(Lane.UPDATES, "update", [bytes(84)])
    assert not outbox.ready(0.0)
    outbox.put(Lane.ANSWERS, "tiles", [bytes([k]) * 100 for k in range(10)], "b")
    outbox.take(0.0)
    assert not outbox.ready(0.0)
    assert outbox.ready(outbox.open_at)


def test_bytes_are_counted_by_class_and_by_topic():
    outbox = Outbox(RADIO, 0.0)
    outbox.put(Lane.UPDATES, "update", [b"abc"])
    outbox.put(Lane.ANSWERS, "update", [b"abcd"], "b")
    outbox.take(0.0)
    assert outbox.spent == {"updates": 3, "answers": 4}
    assert outbox.sent_bytes == {"update": 7}
