"""Meters: as Prometheus reads them."""

from __future__ import annotations

import pytest
from prometheus_client.parser import text_string_to_metric_families

from agent.metrics import exposition
from agent.overview import Overview
from agent.page_snapshot import Snapshots


@pytest.fixture
def meters(watched):
    """What Prometheus would read now: values by name and labels."""
    overview = Overview("lab", ["r1"], 1362.5)
    snapshots = Snapshots(watched.observer, watched.tracks, watched.heard, lambda: {"dropped_inbox_full": 3})

    def read(loop_age: float = 0.25) -> dict[tuple, float]:
        text = exposition(overview.of(snapshots.take(watched.now), exact=True), loop_age).decode()
        found = {}
        for family in text_string_to_metric_families(text):
            assert family.documentation
            assert family.name.startswith("orion_")
            assert family.type in {"gauge", "counter"}
            for sample in family.samples:
                assert sample.name.endswith("_total") == (family.type == "counter")
                found[sample.name, *sample.labels.values()] = sample.value
        return found

    return read


def test_they_tell_how_the_swarm_stands(meters, watched, straight) -> None:
    session = watched.robot("r1")
    watched.sense("r1", straight(20))
    watched.talk(60)
    found = meters()
    assert found["orion_known_area_square_metres",] > 0
    assert found["orion_loop_age_seconds",] == 0.25
    assert found["orion_peers", "robot"] == found["orion_summed_sessions",] == found["orion_agreement",] == 1
    assert found["orion_peers", "observer"] == 0
    assert found["orion_radio_bytes_per_second",] == 1362.5
    held = watched.observer.replicas[session].state.n
    assert found["orion_session_updates_total", "r1", session.hex()] == held > 0
    assert found["orion_session_missing_updates", "r1", session.hex()] == 0


def test_what_we_sent_and_dropped_is_counted_by_name(meters, watched, straight) -> None:
    watched.robot("r1")
    watched.sense("r1", straight(5))
    watched.observer.receive("r1", b"no message", watched.now)
    found = meters()
    assert found["orion_dropped_messages_total", "not_msgpack"] == 1
    assert found["orion_dropped_messages_total", "dropped_inbox_full"] == 3
    for topic, count in watched.observer.sent_bytes.items():
        assert found["orion_sent_bytes_total", topic] == count
    spent = sum(value for name, value in found.items() if name[0] == "orion_spent_bytes_total")
    assert spent == sum(watched.observer.sent_bytes.values()) > 0


def test_sessions_that_nobody_writes_any_more_have_no_series_of_their_own(meters, watched, straight) -> None:
    """A robot that is started a hundred times leaves a hundred sessions in the map."""
    for k in range(5):
        watched.robot(f"r{k}")
        watched.sense(f"r{k}", straight(5))
    before = meters()
    assert sum(name[0] == "orion_session_updates_total" for name in before) == 5
    for k in range(4):
        watched.observer.left(f"r{k}", watched.now)
    after = meters()
    assert sum(name[0] == "orion_session_updates_total" for name in after) == 1
    assert (after["orion_known_sessions",], after["orion_live_sessions",], after["orion_summed_sessions",]) == (5, 1, 5)
