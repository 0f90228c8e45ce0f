# SPDX-License-Identifier: Apache-2.0
"""The state that tabs share, and runs of the whole clip."""

from __future__ import annotations

import asyncio
import signal
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("tomlkit", reason="the tuning page needs the extra tune")

from mr360uw.errors import ParameterError
from mr360uw.sample import SampleDive
from mr360uw.tune.document import Document
from mr360uw.tune.pictures import MadePicture, Wanted
from mr360uw.tune.session import CommandRun, Session
from tests.gate import FIRST_FRAME, Gate


@dataclass(frozen=True)
class Clip:
    """A clip of a second."""

    frame_count: int | None = 24
    frame_rate: Fraction = Fraction(24)
    width: int = 2048


class Studio:
    """Keeps what was asked for."""

    def __init__(self) -> None:
        self.wanted: list[Wanted] = []
        self.stored: dict[int, bytes] = {}
        self.moving = False

    def want(self, wanted: Wanted, *, moving: bool = False, seen: bool = False, playing: bool = False) -> None:
        self.wanted.append(wanted)
        self.moving, self.seen, self.playing = moving, seen, playing

    def played(self) -> list[int]:
        return []

    def settle(self) -> None:
        self.moving = False

    def get(self, number: int) -> bytes | None:
        return b"picture %d" % number

    def store(self, data: bytes) -> int:
        self.stored[100 + len(self.stored)] = data
        return max(self.stored)

    def drop(self, number: int) -> None:
        del self.stored[number]


@pytest.fixture
def session(tmp_path: Path) -> Session:
    (tmp_path / "plate.png").touch()
    (tmp_path / "scene.toml").write_text('plate = "plate.png"\n', "utf-8")
    studio: Any = Studio()
    return Session(Document(tmp_path / "scene.toml"), studio, Clip(), 1024)


def made(session: Session, **changes: Any) -> MadePicture:
    studio: Any = session.pictures
    return replace(MadePicture(studio.wanted[-1], 1024, 512, b"jpeg", number=1, seconds=0.1), **changes)


def test_a_picture_of_an_older_state_is_never_the_present_one(session: Session) -> None:
    session.show()
    first = made(session)
    session.take(replace(first, draft=True))
    assert session.behind
    session.take(first)
    assert not session.behind
    session.document.set("camera.depth_m", 7.0)
    assert session.behind
    session.take(first)  # it comes late
    assert session.behind
    session.take(made(session))
    assert not session.behind
    session.seek(3)
    assert session.behind
    session.take(made(session))
    session.look("plate", width=512)
    assert session.behind


def test_an_error_keeps_the_last_picture(session: Session) -> None:
    session.show()
    session.take(made(session))
    session.document.set("camera.depth_m", 7.0)
    session.take(made(session, problems=("plate - is gone",), data=b""))
    assert session.problems == ("plate - is gone",)
    assert session.picture is not None
    assert session.picture.data == b"jpeg"
    session.take(made(session))
    assert session.problems == ()


def test_seeking_stays_in_the_clip_and_asks_for_full_pictures_at_rest(session: Session) -> None:
    studio: Any = session.pictures
    heard: list[str] = []
    end = session.observe(heard.append)
    session.seek(99, scrubbing=True)
    assert (session.index, session.time_s, studio.wanted[-1].full) == (23, 23 / 24, False)
    session.seek(99)
    assert studio.wanted[-1].full
    assert studio.seen
    assert heard == ["time"]
    session.show()
    assert not studio.seen  # of the same scene, but what its files hold may be new
    session.seek(-4)
    assert session.index == 0
    session.set_range(2, 9)
    assert session.range == (2, 9)
    end()
    for _ in range(2):  # a frame that is not kept any more is made again: the head waits for it
        asked = len(studio.wanted)
        session.seek(5, playing=True)
        assert studio.playing
        assert len(studio.wanted) == asked + 1
    assert heard == ["time"] * 3


def test_full_pictures_wait_while_a_value_is_dragged_alone(session: Session) -> None:
    studio: Any = session.pictures
    session.document.set("camera.depth_m", 7.0)
    assert not studio.moving
    session.document.set("camera.depth_m", 8.0, group="a drag")
    assert studio.moving
    session.pictures.settle()
    assert not studio.moving
    session.document.set("camera.depth_m", 9.0, group="a drag")
    session.document.undo()
    assert not studio.moving


def test_pictures_are_kept_under_names(session: Session) -> None:
    studio: Any = session.pictures
    session.keep_picture("one")
    assert not session.kept_pictures  # there is none yet
    session.show()
    session.take(made(session))
    session.keep_picture("one")
    session.keep_picture("one")
    assert studio.stored == {session.kept_pictures["one"]: b"picture 1"}


def test_one_run_at_a_time(session: Session, tmp_path: Path) -> None:
    run = session.start_run(tmp_path / "out.mp4")
    with pytest.raises(ParameterError, match="going on"):
        session.start_run(tmp_path / "other.mp4")
    run.state = "done"
    assert session.start_run(tmp_path / "other.mp4") is not run


def command(dive: SampleDive, run: CommandRun) -> list[str]:
    return ["composite", str(dive.scene), str(run.out), "--progress-lines", "--frames", "0:3"]


def test_a_run_tells_its_progress_and_what_went_wrong(dive: SampleDive, tmp_path: Path) -> None:
    told: list[tuple[int, int, float | None]] = []
    phases: list[str] = []

    def note() -> None:
        told.append((run.done, run.total, run.seconds_left))
        phases.append(run.phase)

    run = CommandRun(tmp_path / "out.mp4", note)
    asyncio.run(run.run([*command(dive, run), "--scale", "0.25", "--backend", "reference"]))
    assert run.state == "done", run.message
    assert run.out.is_file()
    assert [row[:2] for row in told[-4:-1]] == [(1, 3), (2, 3), (3, 3)]
    assert told[-2][2] == 0.0
    assert list(dict.fromkeys(phases)) == ["reading the light", "rendering"]
    again = CommandRun(tmp_path / "out.mp4", lambda: None)
    asyncio.run(again.run(command(dive, again)))
    assert again.state == "failed"
    assert "already there" in again.message


def test_a_run_that_is_cancelled_says_so(dive: SampleDive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where interrupts are ignored, as by what a shell starts in the background."""
    gate = Gate(tmp_path / "gate", FIRST_FRAME)
    monkeypatch.setenv("PYTHONPATH", gate.path)
    run = CommandRun(tmp_path / "out.mp4", lambda: None)

    async def cancelled_at_the_gate() -> None:
        rendering = asyncio.create_task(run.run([*command(dive, run), "--backend", "reference"]))
        await asyncio.to_thread(gate.wait)
        run.cancel()
        await rendering

    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        asyncio.run(cancelled_at_the_gate())
    finally:
        signal.signal(signal.SIGINT, before)
    assert run.state == "cancelled"
    assert not run.out.exists()
