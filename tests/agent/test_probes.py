"""What a service manager and Prometheus ask: over sockets, of a process without a page."""

from __future__ import annotations

import asyncio
import http.client
import json
import time
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest
from starlette.requests import Request

from agent.config import Config
from agent.errors import UserError
from agent.overview import Overview
from agent.page_mailbox import Mailbox
from agent.page_snapshot import Snapshots
from agent.probe_routes import ALIVE, probe_routes
from agent.probes import Probes


def get(url: str, path: str, **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection(url.split("/")[2], timeout=20)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


@pytest.fixture
def serve(watched) -> Iterator:
    """Serves what the observer knows; gives what its loop is to do in every turn, too."""
    started = []

    def start(host: str = "127.0.0.1") -> tuple[Probes, object]:
        probes = Probes(Config(), host, 0)
        probes.__enter__()
        started.append(probes)
        return probes, probes.watch(watched.observer, watched.heard, dict)

    yield start
    for probes in started:
        probes.__exit__()


def test_a_process_whose_loop_turns_is_well_and_tells_its_meters(serve, watched, straight) -> None:
    probes, turn = serve()
    watched.robot("r1")
    watched.sense("r1", straight(5))
    turn(time.monotonic())
    status, text = get(probes.url, "/healthz")
    assert (status, json.loads(text)["alive"]) == (200, True)
    status, text = get(probes.url, "/metrics")
    assert status == 200
    assert "orion_summed_sessions 1.0" in text.splitlines()
    assert get(probes.url, "/")[0] == get(probes.url, "/api/state")[0] == 404


def test_before_the_loop_has_turned_it_is_not_well(serve) -> None:
    probes, _ = serve()
    assert get(probes.url, "/healthz") == (503, '{"alive":false,"loop_age_seconds":null}')
    assert get(probes.url, "/metrics")[0] == 503


def test_a_loop_that_hangs_is_noticed(watched) -> None:
    mailbox, overview = Mailbox(), Overview("lab", [])
    now = watched.now
    routes = probe_routes(mailbox, lambda: overview.of(mailbox.newest), lambda: now)
    healthz, metrics = (lambda route=route: asyncio.run(route.endpoint(Request({"type": "http"}))) for route in routes)
    mailbox.newest = Snapshots(watched.observer, watched.tracks, watched.heard).take(now)
    assert healthz().status_code == 200
    now += ALIVE
    assert healthz().status_code == 200
    now += 0.1
    answer = healthz()
    assert (answer.status_code, json.loads(answer.body)) == (503, {"alive": False, "loop_age_seconds": ALIVE + 0.1})
    assert f"orion_loop_age_seconds {ALIVE + 0.1}" in metrics().body.decode()


def test_snapshots_are_taken_once_a_second(serve, watched) -> None:
    probes, turn = serve()
    for k in range(31):
        turn(100 + k / 10)
    assert probes._mailbox.newest.now == 103.0
    turn(103.9)
    assert probes._mailbox.newest.now == 103.0


def test_another_site_and_other_machines_are_kept_out_as_from_the_page(serve, watched) -> None:
    probes, turn = serve()
    turn(time.monotonic())
    assert get(probes.url, "/metrics", Host="evil.example")[0] == 421
    assert get(probes.url, "/metrics", Origin="http://evil.example")[0] == 403
    open_ones, turn = serve("0.0.0.0")
    turn(time.monotonic())
    found = urlsplit(open_ones.url)
    token = found.query.removeprefix("token=")
    assert token
    url = f"http://127.0.0.1:{found.port}/"
    assert get(url, "/healthz")[0] == get(url, "/metrics")[0] == 401
    assert get(url, "/metrics", Authorization=f"Bearer {token}")[0] == 200


def test_a_port_that_is_taken_is_the_users_to_mend(serve) -> None:
    probes, _ = serve()
    port = int(probes.url.split(":")[2].strip("/"))
    with pytest.raises(UserError, match=f"--metrics-port: 127.0.0.1:{port}: address already in use; give another one"):
        Probes(Config(), "127.0.0.1", port)
