"""How a swarm stands, in Prometheus' text format.

Laws kept here: names and units as https://prometheus.io/docs/practices/naming/ has them; how many series there are is
bounded by who is there, by the reasons for dropping and by the topics. So a session has its own only while somebody who
is there writes it, and no digest is a label.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector


def exposition(state: dict[str, Any], loop_age: float) -> bytes:
    """The text that Prometheus reads.

    Args:
        state: see ``agent.overview``.
        loop_age: seconds since the peer's loop has turned.
    """
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Collected([*_gauges(state, loop_age), *_sessions(state), *_counters(state)]))
    return generate_latest(registry)


class _Collected(Collector):
    def __init__(self, families: list[Metric]) -> None:
        self._families = families

    def collect(self) -> list[Metric]:
        return self._families


def _gauges(state: dict[str, Any], loop_age: float) -> Iterator[Metric]:
    sessions, peers = state["sessions"], state["peers"]
    values = {
        "loop_age_seconds": ("Since the loop that owns the state has turned.", loop_age),
        "known_area_square_metres": ("Of the global map.", state["known_m2"]),
        "tiles": ("Of the global map.", state["tiles"]),
        "agreement": (
            "1 if everybody who is there said that it holds this map, and nothing is missing.",
            state["agree"],
        ),
        "known_sessions": ("Sessions in whatever condition.", len(sessions)),
        "live_sessions": ("Sessions that somebody who is there writes.", sum(it["live"] for it in sessions)),
        "summed_sessions": ("Sessions that are part of the global map.", sum(it["summed"] for it in sessions)),
        "heard_bytes_per_second": ("Payload bytes that came in, over the last seconds.", state["bytes_rate"]),
    }
    if state["budget"] is not None:
        values["radio_bytes_per_second"] = ("Payload bytes that the shared channel can carry.", state["budget"])
    for name, (meaning, value) in values.items():
        yield GaugeMetricFamily(f"orion_{name}", meaning, value)
    there = GaugeMetricFamily("orion_peers", "Other peers that are there.", labels=["role"])
    robots = sum(it["robot"] for it in peers)
    there.add_metric(["robot"], robots)
    there.add_metric(["observer"], len(peers) - robots)
    yield there


def _sessions(state: dict[str, Any]) -> Iterator[Metric]:
    labels = ["robot", "session"]
    updates = CounterMetricFamily("orion_session_updates", "Updates that are here.", labels=labels)
    missing = GaugeMetricFamily("orion_session_missing_updates", "Updates known of that are not here.", labels=labels)
    summed = GaugeMetricFamily("orion_session_summed", "1 if it is part of the global map.", labels=labels)
    age = GaugeMetricFamily("orion_session_age_seconds", "Since its writer, or news of it, was heard.", labels=labels)
    for it in state["sessions"]:
        if not it["live"]:
            continue
        names = [it["robot"], it["session"]]
        updates.add_metric(names, it["n"])
        missing.add_metric(names, max(0, it["known_n"] - it["n"]))
        summed.add_metric(names, it["summed"])
        if it["age"] is not None:
            age.add_metric(names, it["age"])
    yield from (updates, missing, summed, age)


def _counters(state: dict[str, Any]) -> Iterator[Metric]:
    for name, meaning, label, counts in (
        ("dropped_messages", "Messages that were dropped.", "reason", state["dropped"]),
        ("sent_bytes", "Payload bytes given to the bus.", "topic", state["sent"]),
        ("spent_bytes", "The same by class of traffic.", "class", state["spent"]),
    ):
        family = CounterMetricFamily(f"orion_{name}", meaning, labels=[label])
        for value, count in sorted(counts.items()):
            family.add_metric([value], count)
        yield family
