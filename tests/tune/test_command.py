# SPDX-License-Identifier: Apache-2.0
"""The command `tune`: what it opens, and what it says of bad input."""

from __future__ import annotations

import gc
import importlib.util
import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from mr360uw import cli
from mr360uw.sample import SampleDive


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run the command line in this process; return its exit code."""
    monkeypatch.setattr(gc, "freeze", bool)  # for other tests go on in it
    monkeypatch.setattr(sys, "argv", ["mr360uw", "tune", *map(str, arguments)])
    try:
        cli.main()
    except SystemExit as done:
        return int(done.code or 0)
    return 0


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What would be served instead of a server."""
    pytest.importorskip("nicegui", reason="the tuning page needs the extra tune")
    from mr360uw.tune import server

    told: list[Any] = []
    monkeypatch.setattr(server, "serve", lambda document, **options: told.append((document, options)))
    return told


def test_without_its_packages_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "nicegui" else found(name))
    assert run(monkeypatch, tmp_path / "scene.toml") == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["error: tune - needs packages that are not installed - pip install 'mr360uw[tune]'"]


def test_a_video_and_a_mesh_become_a_scene(
    dive: SampleDive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, served: list[Any]
) -> None:
    plate, mesh = (Path(shutil.copy(file, tmp_path)) for file in (dive.plate, dive.mesh))
    assert run(monkeypatch, plate, mesh, "--port", "8123", "--backend", "reference") == 0
    ((document, options),) = served
    assert document.path == plate.with_suffix(".toml")
    assert document.scene.objects[0].mesh == mesh
    assert (options["port"], options["host"], options["backend"]) == (8123, "127.0.0.1", "reference")
    assert run(monkeypatch, plate, mesh) == 2  # nothing is overwritten
    assert len(served) == 1


def test_a_broken_scene_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], served: list[Any]
) -> None:
    (tmp_path / "scene.toml").write_text("[camera]\ndepth_m = -1\n", "utf-8")
    assert run(monkeypatch, tmp_path / "scene.toml") == 2
    assert "camera.depth_m - must be > 0" in capsys.readouterr().err
    assert not served


def test_a_port_that_is_taken_is_told(
    dive: SampleDive, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("nicegui", reason="the tuning page needs the extra tune")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert run(monkeypatch, dive.scene, "--port", taken.getsockname()[1], "--no-browser") == 2
    assert "--host, --port - cannot be listened on" in capsys.readouterr().err


def test_an_empty_token_is_refused(
    dive: SampleDive, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("nicegui", reason="the tuning page needs the extra tune")
    assert run(monkeypatch, dive.scene, "--no-browser", "--token", "") == 2
    assert "--token - must not be empty (got '') - leave it out for a random one" in capsys.readouterr().err


def test_every_option_that_cannot_be_meant_is_told_before_anything_is_written(
    dive: SampleDive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("nicegui", reason="the tuning page needs the extra tune")
    monkeypatch.setattr("asyncio.run", lambda run: run.close())  # nothing is served
    plate, mesh = (Path(shutil.copy(file, tmp_path)) for file in (dive.plate, dive.mesh))
    for source in ([dive.scene], [plate, mesh]):
        assert run(monkeypatch, *source, "--no-browser", "--port", "0", "--backend", "foo", "--host", "") == 2
        first, second = capsys.readouterr().err.splitlines()
        assert "--host - must not be empty (got '')" in first
        assert "--backend - is not known (got 'foo') - take one of auto, gl, reference" in second
        assert sorted(tmp_path.iterdir()) == sorted([plate, mesh])


def test_the_token_reaches_the_browser_by_a_file_of_the_user_alone(dive: SampleDive, tmp_path: Path) -> None:
    """On loopback too a stranger is refused; the token is not among the arguments of any program."""
    pytest.importorskip("nicegui", reason="the tuning page needs the extra tune")
    seen, browser = tmp_path / "seen.json", tmp_path / "browser.py"
    browser.write_text(
        "import json, os, stat, sys\n"
        "from urllib.parse import urlsplit\n"
        "from urllib.request import url2pathname\n"
        "file = url2pathname(urlsplit(sys.argv[1]).path)\n"
        "rights = [stat.S_IMODE(os.stat(path).st_mode) for path in (file, os.path.dirname(file))]\n"
        f"part = {str(seen)!r} + '.part'\n"
        "json.dump([sys.argv[1], rights, open(file).read()], open(part, 'w'))\n"
        f"os.replace(part, {str(seen)!r})\n",
        "utf-8",
    )
    ours = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}  # NiceGUI looks for it
    ours["BROWSER"] = f"{sys.executable} {browser} %s"
    command = [sys.executable, "-m", "mr360uw", "tune", str(dive.scene), "--port", "0"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=ours)
    try:
        assert server.stdout is not None
        address = server.stdout.readline().strip()
        place, _, token = address.partition("?token=")
        assert len(token) >= 32
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(place, timeout=30.0)
        for _ in range(600):
            if seen.exists():
                break
            time.sleep(0.05)
        argument, rights, page = json.loads(seen.read_text("utf-8"))
    finally:
        server.terminate()
        server.communicate(timeout=60.0)
    assert token not in argument
    assert rights == [0o600, 0o700]
    assert address in page
    assert not Path(urllib.request.url2pathname(urlsplit(argument).path)).exists(), "the file stays behind"
