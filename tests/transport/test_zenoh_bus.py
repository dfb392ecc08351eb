"""What only the Zenoh bus can get wrong: peers that were gossiped about, and strangers on its keys."""

from __future__ import annotations

import json
import time

import pytest
import zenoh

from transport.bus import Joined, Message
from transport.zenoh_bus import ZenohBus

pytestmark = pytest.mark.processes


def test_peers_that_only_know_a_third_meet_through_it(zenoh_harness, free_endpoint):
    hub, other = free_endpoint(), free_endpoint()
    with (
        ZenohBus("test", "hub", listen=[hub], connect=[]),
        ZenohBus("test", "a", listen=[free_endpoint()], connect=[hub]) as a,
        ZenohBus("test", "b", listen=[other], connect=[hub]) as b,
    ):
        wanted = {Joined("hub"), Joined("b")}
        zenoh_harness.receive_until(a, lambda events: wanted <= set(events))
        a.send("b", b"direct")
        zenoh_harness.receive_until(b, lambda events: Message("a", b"direct") in events)


def test_what_is_served_is_given_to_whoever_asks_for_it(free_endpoint):
    endpoint = free_endpoint()
    values = {"size": b"2", "0/-1": b"here", "7/3": b""}
    with ZenohBus("test", "a", listen=[endpoint], connect=[]) as a, a_stranger(endpoint) as stranger:
        a.serve("map", values.items)

        def asked(selector: str) -> dict[str, bytes]:
            replies = [reply.ok for reply in stranger.get(selector)]
            return {str(each.key_expr): each.payload.to_bytes() for each in replies}

        prefix = "orion/test/a/map"
        deadline = time.monotonic() + 15.0
        while not asked("orion/test/*/map/**"):
            assert time.monotonic() < deadline
        assert asked("orion/test/*/map/**") == {f"{prefix}/{name}": value for name, value in values.items()}
        assert asked("orion/test/a/map/0/*") == {f"{prefix}/0/-1": b"here"}
        assert asked("orion/other/*/map/**") == {}
        values["7/3"] = b"new"
        assert asked("orion/test/*/map/7/3") == {f"{prefix}/7/3": b"new"}


def a_stranger(endpoint: str) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("transport/shared_memory/enabled", "false")
    return zenoh.open(config)


def test_what_strangers_put_on_our_keys_is_dropped_and_counted(zenoh_harness, free_endpoint):
    endpoint = free_endpoint()
    with ZenohBus("test", "a", listen=[endpoint], connect=[]) as a, a_stranger(endpoint) as stranger:
        liveliness = stranger.liveliness()
        tokens = [liveliness.declare_token(f"orion/test/{name}/alive") for name in ("not a name", "a", "stranger")]
        zenoh_harness.receive_until(a, lambda events: Joined("stranger") in events)
        stranger.put("orion/test/not a name/news", b"x")
        stranger.put("orion/test/a/news", b"x")
        stranger.delete("orion/test/stranger/news")
        stranger.put("orion/test/stranger/news", b"fine")
        assert zenoh_harness.receive_until(a, bool) == [Message("stranger", b"fine")]
        assert a.counters["received"] == 1
        assert a.counters["dropped_bad_name"] >= 2  # the token and the message
        assert a.counters["dropped_own_name"] == 1
        assert a.counters["dropped_not_a_put"] == 1
        assert tokens
