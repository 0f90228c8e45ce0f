# SPDX-License-Identifier: Apache-2.0
"""The command `tune`: what it opens, and what it says of bad input."""

from __future__ import annotations

import importlib.util
import shutil
import socket
import sys
from pathlib import Path
from typing import Any

import pytest

from mr360uw import cli
from mr360uw.sample import SampleDive


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run the command line in this process; return its exit code."""
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
    assert lines == ["error: tune - needs packages that are not installed - pip install mr360uw[tune]"]


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
