# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium and a server for tests of pages; skips with the reason where something is missing."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

FLAGS = [
    "--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
]  # fmt: skip
PROGRAMS = ("chromium", "chromium-browser", "google-chrome")


def chromium() -> str:
    """Return the path of a Chromium, or skip."""
    pytest.importorskip("nicegui", reason="the tuning page needs the extra tune")
    pytest.importorskip("playwright", reason="tests of pages need playwright")
    found = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if found is None:
        pytest.skip(f"tests of pages need a Chromium (none of {', '.join(PROGRAMS)} is installed)")
    return found


@contextmanager
def started() -> Iterator[Any]:
    """Yield a browser."""
    program = chromium()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        yield browser
        browser.close()


@contextmanager
def served(module: str) -> Iterator[str]:
    """Run a module as a program with a free port as its argument; yield the address once it answers."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"http://127.0.0.1:{port}"
    ours = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}  # NiceGUI looks for it
    command = [sys.executable, "-m", module, str(port)]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=ours)
    try:
        for _ in range(600):
            if server.poll() is not None:
                raise RuntimeError(f"{module} ended: {server.stderr.read() if server.stderr else ''}")
            try:
                urllib.request.urlopen(f"{address}/told", timeout=5.0).close()
                break
            except OSError:
                time.sleep(0.05)
        yield address
    finally:
        server.terminate()
        server.wait()
        if server.stderr is not None:
            server.stderr.close()
