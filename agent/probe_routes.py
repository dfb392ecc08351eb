"""What a service manager and Prometheus ask a process: ``/healthz`` and ``/metrics``.

Law kept here: they are answered from the newest snapshot, in the server's thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from agent.page_mailbox import Mailbox

ALIVE = 5.0
"""Seconds within which the loop of a healthy process turns, many times."""


def probe_routes(
    mailbox: Mailbox, state: Callable[[], dict[str, Any]], clock: Callable[[], float] = time.monotonic
) -> list[Route]:
    """The two routes.

    Args:
        mailbox: where snapshots come from, their ``now`` on that clock.
        state: how the swarm stands (``agent.overview``), empty before that is known.
        clock: seconds.
    """

    def loop_age() -> float | None:
        return None if mailbox.newest is None else round(max(0.0, clock() - mailbox.newest.now), 3)

    async def healthz(request: Request) -> Response:
        age = loop_age()
        alive = age is not None and age <= ALIVE
        return JSONResponse({"alive": alive, "loop_age_seconds": age}, 200 if alive else 503)

    async def metrics(request: Request) -> Response:
        from prometheus_client import CONTENT_TYPE_PLAIN_0_0_4

        from agent.metrics import exposition

        age, known = loop_age(), state()
        if age is None or not known:
            return JSONResponse({"error": "nothing is known yet"}, 503)
        return Response(exposition(known, age), headers={"content-type": CONTENT_TYPE_PLAIN_0_0_4})

    return [Route("/healthz", healthz), Route("/metrics", metrics)]
