"""Orders: checked whole before anything happens, carried out by the loop, and what came of them is told."""

from __future__ import annotations

import pytest

from agent.page_orders import MOST_WAITING, Evict, Orders, Place, Play, Seek, parse
from agent.page_source import PeerSource
from mapping.pose import QuantisedPose

SESSION = "7231723172317231"  # r1, four times


def source_of(watched) -> PeerSource:
    return PeerSource(watched.observer, watched.tracks, watched.heard)


def test_good_orders_are_understood() -> None:
    assert parse("evict", {"session": SESSION}) == Evict(b"r1r1r1r1", readmit=False)
    assert parse("readmit", {"session": SESSION}) == Evict(b"r1r1r1r1", readmit=True)
    fields = {"robot": "r1", "x_mm": -5, "y_mm": 7, "yaw_turn16": 65536 + 3}
    assert parse("start-pose", fields) == Place("r1", QuantisedPose(-5, 7, 3))
    assert parse("seek", {"seconds": 3}) == Seek(3.0)
    assert parse("play", {"speed": 0.5}) == Play(0.5)


@pytest.mark.parametrize(
    ("kind", "fields", "why"),
    [
        ("launch", {}, "'launch' is no order"),
        ("evict", [], "JSON object"),
        ("evict", {"session": 5}, "16 hex digits"),
        ("evict", {"session": "zz"}, "16 hex digits"),
        ("evict", {"session": SESSION, "robot": "r1"}, "16 hex digits"),
        ("start-pose", {"robot": "r1"}, "x_mm"),
        ("start-pose", {"robot": "no such name", "x_mm": 0, "y_mm": 0, "yaw_turn16": 0}, "robot"),
        ("start-pose", {"robot": "r1", "x_mm": 0.5, "y_mm": 0, "yaw_turn16": 0}, "whole numbers"),
        ("start-pose", {"robot": "r1", "x_mm": True, "y_mm": 0, "yaw_turn16": 0}, "whole numbers"),
        ("start-pose", {"robot": "r1", "x_mm": 10**12, "y_mm": 0, "yaw_turn16": 0}, "from the origin"),
        ("seek", {"seconds": -1}, "seconds: a number from 0"),
        ("seek", {"seconds": float("nan")}, "seconds: a number"),
        ("play", {"speed": True}, "speed: a number"),
        ("play", {"speed": 1e9}, "to 1000"),
        ("play", {"speed": 1, "seconds": 1}, "speed"),
    ],
)
def test_bad_orders_are_refused_with_a_reason(kind, fields, why) -> None:
    with pytest.raises(ValueError, match=why):
        parse(kind, fields)


def test_orders_take_effect_when_the_loop_takes_them(watched, straight) -> None:
    session = watched.robot("r1")
    watched.sense("r1", straight(5))
    before = watched.observer.fusion.digest()
    orders = Orders()
    out = orders.give(Evict(session, readmit=False))
    assert not out.done()
    assert session not in watched.observer.controls.evicted
    orders.carry_out(source_of(watched).obey, watched.now)
    assert out.result(0) is None
    assert session in watched.observer.controls.evicted
    orders.give(Evict(session, readmit=True))
    place = orders.give(Place("r1", QuantisedPose(1, 2, 3)))
    orders.carry_out(source_of(watched).obey, watched.now)
    assert place.result(0) is None
    assert watched.observer.controls.start_pose("r1").pose == QuantisedPose(1, 2, 3)
    assert watched.observer.fusion.digest() == before


def test_what_cannot_be_decided_is_told_and_changes_nothing(watched) -> None:
    orders = Orders()
    strangers = [
        orders.give(Evict(b"stranger", readmit=False)),
        orders.give(Place("r9", QuantisedPose(0, 0, 0))),
        orders.give(Seek(1.0)),
    ]
    orders.carry_out(source_of(watched).obey, watched.now)
    for each, why in zip(strangers, ("is not held here", "r9 is unknown", "wound back"), strict=True):
        with pytest.raises(ValueError, match=why):
            each.result(0)
    assert len(watched.observer.controls) == 0


def test_orders_do_not_pile_up() -> None:
    orders = Orders()
    for _ in range(MOST_WAITING):
        orders.give(Place("r1", QuantisedPose(0, 0, 0)))
    with pytest.raises(ValueError, match="too many"):
        orders.give(Place("r1", QuantisedPose(0, 0, 0)))


def test_an_order_that_nobody_waits_for_any_more_is_not_carried_out(watched) -> None:
    session = watched.robot("r1")
    watched.talk()
    orders = Orders()
    given_up, next_one = orders.give(Evict(session, readmit=False)), orders.give(Place("r1", QuantisedPose(1, 2, 3)))
    assert given_up.cancel()
    assert orders.carry_out(source_of(watched).obey, watched.now)
    assert session not in watched.observer.controls.evicted
    assert next_one.result(0) is None
