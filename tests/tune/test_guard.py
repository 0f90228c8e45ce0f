# SPDX-License-Identifier: Apache-2.0
"""The guard before the tuning page: names, origins, tokens, headers."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import MutableMapping
from typing import Any

import pytest

from mr360uw.tune.server import Guard, is_loopback

Message = MutableMapping[str, Any]


def asked(
    guard: Guard, headers: dict[str, str] | list[tuple[str, str]], path: str = "/", query: str = "", kind: str = "http"
) -> tuple[list[Message], bool]:
    """Return what a guard sends for one connection, and whether it let the connection through."""
    pairs = headers.items() if isinstance(headers, dict) else headers
    scope = {
        "type": kind, "path": path, "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in pairs],
    }  # fmt: skip
    sent: list[Message] = []

    async def receive() -> Message:
        return {"type": f"{kind}.connect"}

    async def send(message: Message) -> None:
        sent.append(message)

    asyncio.run(guard(scope, receive, send))
    return sent, any(message.get("body") == b"the page" or message["type"] == "websocket.accept" for message in sent)


async def page(scope: Message, _receive: Any, send: Any) -> None:
    """An application that lets everyone in."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
    elif scope["type"] == "http":
        await send({"type": "http.response.start", "status": 200, "headers": [(b"referrer-policy", b"unsafe-url")]})
        await send({"type": "http.response.body", "body": b"the page"})
    else:
        await send({"type": "lifespan.startup.complete"})


CONNECTIONS = [
    ("127.0.0.1", {"host": "127.0.0.1:8360"}, True),
    ("127.0.0.1", {"host": "localhost:8360"}, True),
    ("127.0.0.1", {"host": "[::1]:8360"}, True),
    ("127.0.0.1", {"host": "LOCALHOST:8360", "origin": "http://localhost:8360"}, True),
    ("127.0.0.1", {"host": "evil.example:8360"}, False),  # a name that points here
    ("127.0.0.1", {"host": "localhost.evil.example"}, False),
    ("127.0.0.1", {"host": "192.168.0.7:8360"}, False),
    ("127.0.0.1", {"host": "[::1"}, False),
    ("127.0.0.1", {}, False),
    ("127.0.0.1", [("host", "127.0.0.1:8360"), ("host", "evil.example")], False),
    ("127.0.0.1", {"host": "127.0.0.1:8360", "origin": "http://127.0.0.1:8360"}, True),
    ("127.0.0.1", {"host": "127.0.0.1:8360", "origin": "http://evil.example"}, False),
    ("127.0.0.1", {"host": "127.0.0.1:8360", "origin": "http://127.0.0.1:9000"}, False),  # another local server
    ("127.0.0.1", {"host": "127.0.0.1:8360", "origin": "null"}, False),
    ("127.0.0.1", {"host": "127.0.0.1:8360", "origin": "file://127.0.0.1:8360"}, False),
    ("192.168.0.7", {"host": "192.168.0.7:8360"}, True),
    ("192.168.0.7", {"host": "localhost:8360"}, False),
    ("0.0.0.0", {"host": "192.168.0.7:8360"}, True),
    ("0.0.0.0", {"host": "evil.example:8360"}, False),
]


def test_only_own_names_and_own_pages_get_through(subtests: pytest.Subtests) -> None:
    for kind in ["http", "websocket"]:
        for host, headers, expected in CONNECTIONS:
            with subtests.test(kind, host=host, headers=headers):
                pairs = list(headers.items() if isinstance(headers, dict) else headers)
                place = pairs[0][1] if pairs else ""
                shown = ("cookie", f"mr360uw_{place.rsplit(':', 1)[-1] if ':' in place else 80}=s3cret")
                sent, through = asked(Guard(page, host, "s3cret"), [*pairs, shown], kind=kind)
                assert through == expected
                if not expected and kind == "http":
                    assert sent[0]["status"] == 403
                    assert b"the page" not in sent[1]["body"]
                elif not expected:
                    assert (sent[0]["type"], sent[0]["code"]) == ("websocket.close", 1008)


OWN = {"host": "192.168.0.7:8360"}


def test_a_token_is_taken_from_the_query_once_and_then_from_the_cookie() -> None:
    guard = Guard(page, "192.168.0.7", "s3cret")
    sent, through = asked(guard, OWN, path="/", query="token=s3cret&a=1")
    assert not through
    answer = dict(sent[0]["headers"])
    assert (sent[0]["status"], answer[b"location"]) == (303, b"/?a=1")
    cookie = answer[b"set-cookie"].decode()
    assert {"HttpOnly", "SameSite=Lax", "Path=/"} <= set(cookie.split("; "))
    pair = cookie.split(";")[0]
    for kind in ("http", "websocket"):
        assert asked(guard, {**OWN, "cookie": f"theme=dark; {pair}"}, kind=kind)[1]
        assert not asked(guard, {**OWN, "cookie": pair.replace("8360", "8361")}, kind=kind)[1]
        assert not asked(guard, {**OWN, "cookie": pair[:-1]}, kind=kind)[1]
        assert not asked(guard, {**OWN, "cookie": pair, "origin": "http://evil.example"}, kind=kind)[1]
        assert not asked(guard, OWN, kind=kind)[1]
        assert not asked(guard, {**OWN, "cookie": "a=b=c;;=\u00e4"}, kind=kind)[1]


@pytest.mark.parametrize("query", ["", "token=", "token=S3CRET", "token=s3cret1", "t=s3cret", "token=%C3%A9"])
def test_a_wrong_token_is_refused(query: str) -> None:
    sent, through = asked(Guard(page, "192.168.0.7", "s3cret"), OWN, query=query)
    assert not through
    assert sent[0]["status"] == 403
    assert b"s3cret" not in sent[1]["body"]
    assert not asked(Guard(page, "192.168.0.7", "s3cret"), OWN, query="token=s3cret", kind="websocket")[1]


@pytest.mark.parametrize("path", ["//evil.example/", "/picture/1", "/\\evil.com", "/\r\nset-cookie: a=b"])
def test_a_token_opens_the_page_alone(path: str) -> None:
    """Nothing of the request's path ever stands in an answer's headers."""
    sent, through = asked(Guard(page, "192.168.0.7", "s3cret"), OWN, path=path, query="token=s3cret")
    assert not through
    assert sent[0]["status"] in (400, 403)
    assert b"location" not in dict(sent[0]["headers"])


@pytest.mark.parametrize("origin", ["http://[::1", "http://[v1.a"])
def test_an_origin_that_cannot_be_read_is_a_bad_request(origin: str) -> None:
    sent, through = asked(Guard(page, "127.0.0.1", "s3cret"), {"host": "127.0.0.1:8360", "origin": origin})
    assert not through
    assert sent[0]["status"] == 400


def test_answers_forbid_foreign_loads() -> None:
    sent, _ = asked(Guard(page, "127.0.0.1", "s3cret"), {"host": "127.0.0.1", "cookie": "mr360uw_80=s3cret"})
    headers = dict(sent[0]["headers"])
    policy = headers[b"content-security-policy"].decode()
    assert "default-src 'self'" in policy
    assert "http:" not in policy
    assert "*" not in policy
    assert headers[b"referrer-policy"] == b"no-referrer"
    assert headers[b"cross-origin-resource-policy"] == b"same-origin"


def test_the_start_of_the_server_gets_through() -> None:
    sent, _ = asked(Guard(page, "127.0.0.1", "s3cret"), {}, kind="lifespan")
    assert sent[0]["type"] == "lifespan.startup.complete"


@pytest.mark.parametrize(
    ("host", "expected"),
    [("127.0.0.1", True), ("127.8.8.8", True), ("localhost", True), ("::1", True), ("0.0.0.0", False),
     ("192.168.0.7", False), ("reef.example", False), ("localhost.example", False)],
)  # fmt: skip
def test_loopback(host: str, expected: bool) -> None:
    assert is_loopback(host) == expected


@pytest.mark.parametrize(("problem", "raised"), [("No response returned.", False), ("the page is broken", True)])
def test_a_browser_that_goes_before_its_answer_is_no_fault(problem: str, raised: bool) -> None:
    """Starlette raises there, and the terminal would show a traceback for every tab that is closed."""

    async def gone(*_: Any) -> None:
        raise RuntimeError(problem)

    cookie = dict(asked(Guard(page, "192.168.0.7", "s3cret"), OWN, query="token=s3cret")[0][0]["headers"])
    shown = {**OWN, "cookie": cookie[b"set-cookie"].decode().partition(";")[0]}
    with pytest.raises(RuntimeError, match="broken") if raised else contextlib.nullcontext():
        assert asked(Guard(gone, "192.168.0.7", "s3cret"), shown) == ([], False)
