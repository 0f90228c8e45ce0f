# SPDX-License-Identifier: Apache-2.0
"""Serves the tuning page of one document until it is interrupted."""

from __future__ import annotations

import asyncio
import errno
import hmac
import html
import ipaddress
import itertools
import logging
import secrets
import socket
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlencode, urlsplit

import uvicorn
from fastapi import FastAPI
from fastapi.responses import FileResponse, PlainTextResponse, Response
from nicegui import ui
from starlette.datastructures import MutableHeaders, QueryParams
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from mr360uw.base.files import write_whole
from mr360uw.base.progress import one_blas_thread
from mr360uw.errors import ParameterError
from mr360uw.render.frame import check_backend
from mr360uw.scene.resolved import open_plate
from mr360uw.tune.controls import TOLD
from mr360uw.tune.document import Document
from mr360uw.tune.page import TunePage
from mr360uw.tune.pictures import MadePicture, PageRenderer, Pictures
from mr360uw.tune.session import Session
from mr360uw.video import VideoReader

PORT = 8360
"""Port that is taken where none is asked for and it is free."""
_POLL_S = 1.0
"""Time between two looks at the scene file [s]; a change of it shows up so much later at the most."""
_WIDTH = 1024
"""Width of full pictures at the start [pixels]; four times as many take four times as long."""
_SWITCH_S = 0.0005
"""Time after which the thread that draws lets the one that answers run [s], which waits as long at each answer. A tenth
of Python's own; a hundredth would cost the drawing 1 %."""
_NO_STORE = {"Cache-Control": "no-store"}


def serve(
    document: Document,
    *,
    host: str = "127.0.0.1",
    port: int | None = None,
    token: str | None = None,
    backend: str = "auto",
    tell: Callable[[str], None],
    show: Callable[[Path], None] = lambda _: None,
) -> None:
    """Serve a document's page until the process is interrupted.

    port: None takes `PORT`, or a free one where that is taken. token: that visitors must show; None makes a random one.
    tell: called with the page's address once it answers, and with what becomes of unsaved changes. show: called then
    with a file that leads a browser to that address: only its owner can read it, whereas all users of the machine can
    read the arguments of a program. Raises `ParameterError` where the address cannot be had, as `check_options`, and
    what opening the plate raises.
    """
    check_options(host, token, backend)
    with open_plate(document.scene) as clip:  # whose length and size stay known
        pass
    token = secrets.token_urlsafe(24) if token is None else token
    listening = _listen(host, port)
    name = f"[{host}]" if ":" in host else host
    address = f"http://{name}:{listening.getsockname()[1]}/?{urlencode({'token': token})}"
    private = TemporaryDirectory(prefix="mr360uw-")  # which its owner alone can enter
    door = Path(private.name) / "tune.html"
    door.write_text(f'<meta http-equiv="refresh" content="0; url={html.escape(address)}">', "utf-8")
    door.chmod(0o600)

    def answers() -> None:
        tell(address)
        show(door)

    app = _application(document, clip, backend, answers)
    config = uvicorn.Config(
        Guard(app, host, token), log_level="warning", access_log=False, lifespan="on", ws_max_size=2**22,
        timeout_graceful_shutdown=2,
    )  # fmt: skip
    try:
        sys.setswitchinterval(_SWITCH_S)
        with one_blas_thread():  # two threads draw and answer: their products would wait for each other's BLAS threads
            asyncio.run(uvicorn.Server(config).serve(sockets=[listening]))
    finally:
        listening.close()
        private.cleanup()
        if document.dirty:
            names = (document.path.with_suffix(f".unsaved{number or ''}.toml") for number in itertools.count())
            path = next(name for name in names if not name.exists() and not name.is_symlink())
            write_whole(path, document.text)
            tell(f"changes that were not saved are in {path}")


def check_options(host: str, token: str | None, backend: str) -> None:
    """Raise `ParameterError` with a line for each option that cannot be meant.

    An empty host would be listened on by every address of the machine; an empty token would let everybody in.
    """
    wrong = []
    if host == "":
        wrong.append("--host - must not be empty (got '') - leave it out for this machine alone, or name an address")
    if token == "":
        wrong.append("--token - must not be empty (got '') - leave it out for a random one")
    try:
        check_backend(backend)
    except ParameterError as error:
        wrong.append(f"--{error}")
    if wrong:
        raise ParameterError("\n".join(wrong))


def _listen(host: str, port: int | None) -> socket.socket:
    """Return a socket that listens; raise `ParameterError` where it cannot."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for number in [PORT, 0] if port is None else [port]:
        listening = socket.socket(family, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((host, number))
        except (OSError, OverflowError) as error:
            listening.close()
            if port is None and number and getattr(error, "errno", 0) == errno.EADDRINUSE:
                continue
            reason = getattr(error, "strerror", None) or str(error)
            raise ParameterError(
                f"--host, --port - cannot be listened on (got {host}, {number}: {reason}) - take another, or port 0"
            ) from None
        listening.listen(64)
        return listening
    raise AssertionError


def _application(document: Document, clip: VideoReader, backend: str, ready: Callable[[], None]) -> FastAPI:
    """Return the application of a document's page. ready: called once it answers."""
    held: list[Session] = []

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        loop = asyncio.get_running_loop()

        def publish(picture: MadePicture) -> None:
            loop.call_soon_threadsafe(lambda: held[0].take(picture))

        pictures = Pictures(lambda: PageRenderer(backend), publish)
        held.append(Session(document, pictures, clip, _WIDTH, backend))
        watch = loop.create_task(_watch(document))
        loop.call_soon(ready)
        try:
            yield
        finally:
            watch.cancel()
            if held[0].run is not None:
                held[0].run.cancel()
            await asyncio.to_thread(pictures.close)

    app = FastAPI(lifespan=lifespan, openapi_url=None, docs_url=None, redoc_url=None)

    @app.get("/picture/{number}")
    async def picture(number: int) -> Response:  # not in a thread of its own, which would have to be woken
        found = held[0].pictures.get(number)
        if found is None:
            return Response(status_code=404, headers=_NO_STORE)
        return Response(found, media_type="image/jpeg", headers=_NO_STORE)

    @app.get("/result")
    def result() -> Response:
        run = held[0].run
        if run is None or run.state != "done" or not run.out.is_file():
            return Response(status_code=404, headers=_NO_STORE)
        return FileResponse(run.out, headers=_NO_STORE)

    @app.get("/tune/{name}")
    def part(name: str) -> Response:
        if name not in ("page.css", "page.js"):
            return Response(status_code=404)
        return FileResponse(Path(__file__).with_name(name), headers={"Cache-Control": "no-cache"})

    @ui.page("/", response_timeout=20.0)
    def page() -> None:
        TunePage(held[0])
        if held[0].picture is None:
            ui.context.client.on_connect(held[0].show)  # only then: what draws takes a second to load

    # Errors that a tab tells are no faults, of which the terminal has the details
    logging.getLogger("nicegui").addFilter(
        lambda record: not (record.exc_info and isinstance(record.exc_info[1], TOLD))
    )
    ui.run_with(
        app, title=f"{document.path.name} - mr360uw", dark=None, language="en-US", tailwind=False,
        show_welcome_message=False, reconnect_timeout=10.0, binding_refresh_interval=None,
    )  # fmt: skip
    return app


async def _watch(document: Document) -> None:
    while True:
        await asyncio.sleep(_POLL_S)
        document.poll()


# Access control of the tuning page: its own pages and holders of its token get through, nobody else.
#
# A page on another site can send requests to an address on this machine. Those are known by their `Origin`; a name that
# was made to point here (DNS rebinding) is known by `Host`. Another user of this machine can connect to its loopback
# addresses; he does not know the token.

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
_HEADERS = {
    "content-security-policy": _CONTENT_POLICY,
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
}
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


_NOBODY_THERE = "No response returned."
"""What starlette raises where a browser has gone before its answer began."""


class Guard:
    """An ASGI application before another one.

    host: that is listened on. token: that requests must show, in the query of "/" once and then in a cookie.
    """

    def __init__(self, app: ASGIApp, host: str, token: str) -> None:
        self._app, self._host, self._token = app, host.strip("[]").lower(), token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        asked = HTTPConnection(scope)
        hosts, origins = asked.headers.getlist("host"), asked.headers.getlist("origin")
        if any(character in scope["path"] for character in _NO_PATH) or not all(map(_is_readable, origins)):
            await _refuse(scope, receive, send, "this request cannot be read", _BAD_REQUEST)
        elif len(hosts) != 1 or not self._is_own(hosts[0]):
            await _refuse(
                scope, receive, send, "this name does not stand for this page: use the address it was started with"
            )
        elif any(not _same_place(origin, hosts[0]) for origin in origins):
            await _refuse(scope, receive, send, "requests of other pages are not answered")
        elif scope["type"] == "http" and scope["path"] == "/" and self._is_token(asked.query_params.get("token", "")):
            await self._welcome(asked.query_params, hosts[0])(scope, receive, send)
        elif self._is_token(asked.cookies.get(_cookie_name(hosts[0]), "")):
            try:
                await self._app(scope, receive, _with_headers(send))
            except RuntimeError as error:
                if str(error) != _NOBODY_THERE:
                    raise
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

    def _welcome(self, query: QueryParams, host: str) -> Response:
        """Return an answer that sets the cookie and leads to "/" without the token.

        A strict cookie would not be sent where a local file leads here, as the one does that opens the browser.
        """
        rest = urlencode([(name, value) for name, value in query.multi_items() if name != "token"])
        cookie = f"{_cookie_name(host)}={self._token}; Path=/; HttpOnly; SameSite=Lax"
        return Response(b"", 303, {"location": f"/?{rest}" if rest else "/", "set-cookie": cookie, **_HEADERS})


def _cookie_name(host: str) -> str:
    """Return the name of the cookie; with the port, as browsers send cookies to all ports of a host."""
    return f"mr360uw_{urlsplit(f'//{host}').port or 80}"


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
    async def wrapped(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message).update(_HEADERS)
        await send(message)

    return wrapped


async def _refuse(scope: Scope, receive: Receive, send: Send, why: str, status: int = _FORBIDDEN) -> None:
    if scope["type"] == "websocket":
        await receive()
        await WebSocketClose(_POLICY_VIOLATION, why)(scope, receive, send)
    else:
        await PlainTextResponse(why, status, _HEADERS)(scope, receive, send)
