"""Who may see and use the page.

Laws kept here: on a loopback address the page is for this machine, and a web site that a browser here looks at shall
not reach it by a name of its own (the host must be a loopback one) or from its own pages (the origin must be ours);
on any other address whoever has the token is let in, and nobody else.
"""

from __future__ import annotations

import secrets
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from agent.page_options import is_loopback

COOKIE = "orion_page"

HEADERS = {
    "content-security-policy": "default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cache-control": "no-cache",
}
"""Of every answer: the page asks nobody but its own server for anything, and no other page may hold it in a frame."""


class Guard:
    """Stands before an app.

    Args:
        app: what is guarded.
        token: what must be shown, or None: then only loopback hosts are answered.
    """

    def __init__(self, app: ASGIApp, token: str | None) -> None:
        self._app = app
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or pass on what may pass."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                mine = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
                message = {**message, "headers": [*message["headers"], *mine]}
            await send(message)

        if (refused := self._refusal(scope)) is None:
            await self._app(scope, receive, send_with_headers)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
        else:
            await refused(scope, receive, send_with_headers)

    def _refusal(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        if self._token is None and not is_loopback(_name(host)):
            return PlainTextResponse("this page is for this machine alone", 421)
        if origin is not None and _site(origin) != host:
            return PlainTextResponse("another page asks", 403)
        if self._token is None:
            return None
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [""])[0]
        if _same(given, self._token) and scope["type"] == "http" and scope["method"] == "GET":
            response = RedirectResponse(scope["path"], 303)  # the token leaves the address bar
            response.set_cookie(COOKIE, self._token, httponly=True, samesite="strict")
            return response
        shown = (_cookie(headers), headers.get("authorization", "").removeprefix("Bearer "))
        if any(_same(each, self._token) for each in shown):
            return None
        return PlainTextResponse("give the token: the address with ?token=... that orion printed", 401)


def _same(given: str, token: str) -> bool:
    return secrets.compare_digest(given.encode(), token.encode())


def _name(host: str) -> str:
    """The host without its port and brackets."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _site(origin: str) -> str | None:
    """The host with its port; None if it is no address."""
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return None


def _cookie(headers: Headers) -> str:
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return ""
    return found.value if found is not None else ""
