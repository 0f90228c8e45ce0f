# SPDX-License-Identifier: Apache-2.0
"""Access control of the tuning page: its own pages and holders of its token get through, nobody else.

A page on another site can send requests to an address on this machine. Those are known by their `Origin`; a name that
was made to point here (DNS rebinding) is known by `Host`. Another user of this machine can connect to its loopback
addresses; he does not know the token.
"""

from __future__ import annotations

import hmac
import ipaddress
import socket
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

_CONTENT_POLICY = "; ".join(
    [
        "default-src 'self'",
        "script-src 'self' 'unsafe-inline' 'unsafe-eval'",  # the page's framework compiles templates in the browser
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data: blob:",
        "worker-src 'self' blob:",
        "connect-src 'self'",
        "object-src 'none'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    ]
)
_HEADERS = (
    (b"content-security-policy", _CONTENT_POLICY.encode()),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
)
_BAD_REQUEST, _FORBIDDEN = 400, 403
_NO_PATH = "\\\r\n\0"
"""Characters that no address of the page has; browsers take a backslash for a slash."""
_POLICY_VIOLATION = 1008
"""Close code of a WebSocket that is refused (RFC 6455, 7.4.1)."""


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach a host name or address."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


class Guard:
    """An ASGI application before another one.

    host: that is listened on. token: that requests must show, in the query of "/" once and then in a cookie.
    """

    def __init__(self, app: App, host: str, token: str) -> None:
        self._app, self._host, self._token = app, host.strip("[]").lower(), token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers: list[tuple[bytes, bytes]] = scope["headers"]
        hosts, origins = _values(headers, b"host"), _values(headers, b"origin")
        if any(character in scope["path"] for character in _NO_PATH) or not all(map(_is_readable, origins)):
            await _refuse(scope, receive, send, "this request cannot be read", _BAD_REQUEST)
        elif len(hosts) != 1 or not self._is_own(hosts[0]):
            await _refuse(
                scope, receive, send, "this name does not stand for this page: use the address it was started with"
            )
        elif any(not _same_place(origin, hosts[0]) for origin in origins):
            await _refuse(scope, receive, send, "requests of other pages are not answered")
        elif scope["type"] == "http" and scope["path"] == "/" and self._is_token(_query(scope).get("token", "")):
            await _answer(send, 303, b"", self._welcome(scope, hosts[0]))
        elif self._shows_token(headers, hosts[0]):
            await self._app(scope, receive, _with_headers(send))
        else:
            await _refuse(scope, receive, send, "a token is needed: open the address that was printed at the start")

    def _is_own(self, host: str) -> bool:
        """Return whether a Host header names this server."""
        try:
            name = (urlsplit(f"//{host}").hostname or "").lower()
        except ValueError:
            return False
        if name == self._host or (is_loopback(name) and is_loopback(self._host)):
            return True
        if self._host not in ("0.0.0.0", "::"):  # noqa: S104 - compared, not listened on
            return False
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in ("localhost", socket.gethostname().lower())
        return True  # an address cannot be made to point elsewhere

    def _is_token(self, shown: str) -> bool:
        return hmac.compare_digest(shown.encode(), self._token.encode())

    def _shows_token(self, headers: list[tuple[bytes, bytes]], host: str) -> bool:
        cookies: SimpleCookie = SimpleCookie()
        try:
            for text in _values(headers, b"cookie"):
                cookies.load(text)
        except CookieError:
            return False
        return any(self._is_token(morsel.value) for name, morsel in cookies.items() if name == _cookie_name(host))

    def _welcome(self, scope: Scope, host: str) -> list[tuple[bytes, bytes]]:
        """Return the headers of an answer that sets the cookie and leads to "/" without the token.

        A strict cookie would not be sent where a local file leads here, as the one does that opens the browser.
        """
        rest = urlencode([(k, v) for k, v in parse_qsl(scope["query_string"].decode("latin-1")) if k != "token"])
        place = f"/?{rest}" if rest else "/"
        cookie = f"{_cookie_name(host)}={self._token}; Path=/; HttpOnly; SameSite=Lax"
        return [(b"location", place.encode()), (b"set-cookie", cookie.encode())]


def _cookie_name(host: str) -> str:
    """Return the name of the cookie; with the port, as browsers send cookies to all ports of a host."""
    return f"mr360uw_{urlsplit(f'//{host}').port or 80}"


def _values(headers: Iterable[tuple[bytes, bytes]], name: bytes) -> list[str]:
    return [value.decode("latin-1") for key, value in headers if key.lower() == name]


def _query(scope: Scope) -> dict[str, str]:
    return dict(parse_qsl(scope["query_string"].decode("latin-1")))


def _is_readable(origin: str) -> bool:
    try:
        urlsplit(origin)
    except ValueError:
        return False
    return True


def _same_place(origin: str, host: str) -> bool:
    parts = urlsplit(origin)
    return parts.scheme in ("http", "https") and parts.netloc.lower() == host.lower()


def _with_headers(send: Send) -> Send:
    async def wrapped(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            own = {name for name, _ in _HEADERS}
            kept = [pair for pair in message.get("headers", []) if pair[0].lower() not in own]
            message = {**message, "headers": [*kept, *_HEADERS]}
        await send(message)

    return wrapped


async def _refuse(scope: Scope, receive: Receive, send: Send, why: str, status: int = _FORBIDDEN) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": _POLICY_VIOLATION, "reason": why})
    else:
        await _answer(send, status, why.encode(), [(b"content-type", b"text/plain; charset=utf-8")])


async def _answer(send: Send, status: int, body: bytes, headers: list[tuple[bytes, bytes]]) -> None:
    await send({"type": "http.response.start", "status": status, "headers": [*headers, *_HEADERS]})
    await send({"type": "http.response.body", "body": body})
