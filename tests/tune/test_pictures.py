# SPDX-License-Identifier: Apache-2.0
"""The thread that makes pictures: the newest state wins, drafts come before full pictures, errors keep it going."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from mr360uw.base.input_files import note_read
from mr360uw.errors import SceneError, VideoError
from mr360uw.scene.model import Scene
from mr360uw.tune import pictures
from mr360uw.tune.pictures import MadePicture, Pictures, Wanted

WAIT_S = 20.0  # for events that happen within milliseconds: only a hang takes as long


class Studio:
    """A renderer that waits for its gate before each picture."""

    def __init__(self) -> None:
        self.gate = threading.Semaphore(0)
        self.begun: queue.Queue[int] = queue.Queue()
        self.made: queue.Queue[MadePicture] = queue.Queue()
        self.fails: Exception | None = None
        self.closed = False
        self.nearest: int | None = None
        self.mesh: Path | None = None
        self.pictures = Pictures(lambda: self, self.made.put)

    def picture(self, wanted: Wanted, width: int) -> MadePicture:
        self.begun.put(wanted.revision)
        assert self.gate.acquire(timeout=WAIT_S)
        if self.fails is not None:
            raise self.fails
        if self.mesh is not None:
            note_read(self.mesh)
        return MadePicture(wanted, width, width // 2, f"{wanted.revision}".encode())

    def stand_in(self, wanted: Wanted) -> int:
        return self.nearest if self.nearest is not None else wanted.index

    def close(self) -> None:
        self.closed = True

    def want(self, revision: int, *, full: bool = True, moving: bool = False) -> None:
        self.pictures.want(Wanted(Scene(plate="plate.png"), revision, 0, "composite", 512, full), moving=moving)

    def next(self) -> tuple[int, bool]:
        picture = self.made.get(timeout=WAIT_S)
        return picture.wanted.revision, picture.draft


@pytest.fixture
def studio(monkeypatch: pytest.MonkeyPatch) -> Iterator[Studio]:
    monkeypatch.setattr(pictures, "REST_S", 0.01)
    monkeypatch.setattr(pictures, "_QUICK_S", -1.0)
    made = Studio()
    yield made
    made.gate.release(99)
    made.pictures.close()
    assert made.closed


def test_a_draft_comes_first_and_the_full_picture_after_a_rest(studio: Studio) -> None:
    studio.want(1)
    studio.gate.release(2)
    draft, full = studio.made.get(timeout=WAIT_S), studio.made.get(timeout=WAIT_S)
    assert [(p.wanted.revision, p.draft, p.width, p.height) for p in (draft, full)] == [
        (1, True, 256, 128), (1, False, 512, 256)
    ]  # fmt: skip
    assert draft.number < full.number
    assert studio.pictures.get(full.number) == full.data
    assert studio.pictures.get(99) is None


def test_in_a_drag_the_full_picture_waits_until_it_ends(studio: Studio, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "REST_S", WAIT_S)
    studio.gate.release(9)
    studio.want(1, moving=True)
    assert studio.next() == (1, True)
    assert studio.pictures.ask(lambda _: studio.made.qsize(), urgent=True).result(WAIT_S) == 0
    studio.want(2, moving=True)
    assert studio.next() == (2, True)
    studio.pictures.settle()
    assert studio.next() == (2, False)
    studio.want(3)
    assert [studio.next() for _ in range(2)] == [(3, True), (3, False)]


def test_of_many_changes_only_the_newest_is_drawn(studio: Studio) -> None:
    studio.want(1)
    assert studio.begun.get(timeout=WAIT_S) == 1
    for revision in range(2, 50):
        studio.want(revision)
    studio.gate.release(3)
    assert [studio.next() for _ in range(3)] == [(1, True), (49, True), (49, False)]
    assert studio.made.empty()


def test_the_nearest_keyframe_stands_in_for_a_frame_that_comes_late(studio: Studio) -> None:
    studio.nearest = 7
    studio.want(1)
    studio.gate.release(3)
    made = [studio.made.get(timeout=WAIT_S) for _ in range(3)]
    assert [(p.stand_in, p.draft, p.wanted.index) for p in made] == [
        (True, True, 0), (False, True, 0), (False, False, 0)
    ]  # fmt: skip
    studio.want(2)
    assert studio.begun.get(timeout=WAIT_S) == 1
    while studio.begun.get(timeout=WAIT_S) != 2:
        pass
    studio.nearest = None
    studio.want(3)
    studio.gate.release(3)
    assert [studio.next() for _ in range(3)] == [(2, True), (3, True), (3, False)]


def frame(index: int) -> Wanted:
    return Wanted(Scene(plate="plate.png"), 1, index, "composite", 512)


def test_frames_that_were_made_are_shown_again_until_anything_else_changes(studio: Studio) -> None:
    studio.gate.release(9)
    for index in (0, 1):
        studio.pictures.want(frame(index), seen=True, playing=True)
        assert not studio.made.get(timeout=WAIT_S).draft
    assert studio.pictures.played() == [0, 1]
    for _ in range(2):  # the second loop
        for index in (0, 1):
            studio.pictures.want(frame(index), seen=True, playing=True)
            again = studio.made.get(timeout=WAIT_S)
            assert (again.wanted.index, studio.pictures.get(again.number)) == (index, again.data)
    assert studio.begun.qsize() == 2
    studio.pictures.want(frame(1))
    assert studio.made.get(timeout=WAIT_S).draft
    assert studio.made.get(timeout=WAIT_S).number > again.number
    assert studio.pictures.played() == [1]


def test_frames_that_were_kept_are_made_anew_where_a_file_has_changed(studio: Studio, tmp_path: Path) -> None:
    studio.mesh = tmp_path / "whale.glb"
    studio.mesh.write_bytes(b"one")
    studio.gate.release(9)
    for index in (0, 1, 1):
        studio.pictures.want(frame(index), seen=True, playing=True)
        studio.made.get(timeout=WAIT_S)
    studio.mesh.write_bytes(b"another")
    studio.pictures.want(frame(1), seen=True, playing=True)
    studio.made.get(timeout=WAIT_S)
    assert studio.begun.qsize() == 3
    assert studio.pictures.played() == [1]


def test_frames_made_before_and_after_a_file_changed_are_not_kept_together(studio: Studio, tmp_path: Path) -> None:
    studio.mesh = tmp_path / "whale.glb"
    studio.mesh.write_bytes(b"one")
    studio.gate.release(1)
    studio.pictures.want(frame(0), seen=True, playing=True)
    studio.made.get(timeout=WAIT_S)
    studio.pictures.want(frame(1), seen=True, playing=True)
    for _ in range(2):
        studio.begun.get(timeout=WAIT_S)
    studio.mesh.write_bytes(b"another")
    studio.gate.release(1)
    studio.made.get(timeout=WAIT_S)
    assert studio.pictures.played() == [1]


def test_a_picture_that_comes_late_does_not_hide_the_one_that_was_kept(studio: Studio) -> None:
    studio.gate.release(1)
    studio.pictures.want(frame(0), seen=True, playing=True)
    studio.made.get(timeout=WAIT_S)
    studio.pictures.want(frame(1), seen=True, playing=True)
    for _ in range(2):
        studio.begun.get(timeout=WAIT_S)
    studio.pictures.want(frame(0), seen=True)
    assert studio.made.get(timeout=WAIT_S).wanted.index == 0
    studio.gate.release(1)
    assert studio.pictures.ask(lambda _: studio.made.qsize()).result(WAIT_S) == 0
    assert studio.pictures.played() == [0, 1]


def test_what_is_kept_for_playing_is_bounded(studio: Studio, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "_PLAYED_BYTES", 2)  # each of these has one
    studio.gate.release(9)
    for index in (0, 1, 2):
        studio.pictures.want(frame(index), seen=True, playing=True)
        studio.made.get(timeout=WAIT_S)
    assert studio.pictures.played() == [1, 2]


def test_scrubbing_makes_drafts_only(studio: Studio) -> None:
    studio.gate.release(2)
    studio.want(1, full=False)
    assert studio.next() == (1, True)
    studio.want(2, full=False)
    assert studio.next() == (2, True)


def test_quick_pictures_need_no_draft(studio: Studio, monkeypatch: pytest.MonkeyPatch) -> None:
    studio.gate.release(9)
    studio.want(1)
    assert [studio.next() for _ in range(2)] == [(1, True), (1, False)]
    monkeypatch.setattr(pictures, "_QUICK_S", 1e9)
    studio.want(2)
    assert studio.next() == (2, False)


def test_an_error_is_told_and_the_thread_goes_on(studio: Studio) -> None:
    studio.gate.release(9)
    studio.fails = SceneError("scene.toml", ["one", "two"])
    studio.want(1)
    failed = studio.made.get(timeout=WAIT_S)
    assert (failed.problems, failed.data) == (("one", "two"), b"")
    assert studio.pictures.get(failed.number) is None
    studio.fails = VideoError("plate.png - is gone")
    studio.want(2)
    assert studio.made.get(timeout=WAIT_S).problems == ("plate.png - is gone",)
    studio.fails = None
    studio.want(3)
    assert studio.next() == (3, True)


def test_an_error_that_nobody_expected_is_told_and_the_next_change_draws(
    studio: Studio, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a picture, of the renderer's other work for it; its details are on stderr."""
    studio.gate.release(9)
    studio.fails = KeyError("a fault")
    studio.want(1)
    (line,) = studio.made.get(timeout=WAIT_S).problems
    assert "drawing it failed (got KeyError: 'a fault')" in line
    assert "Traceback" in capsys.readouterr().err
    studio.fails = None
    monkeypatch.setattr(studio, "stand_in", lambda _: 1 // 0)
    studio.want(2)
    assert "ZeroDivisionError" in studio.made.get(timeout=WAIT_S).problems[0]
    monkeypatch.undo()
    studio.want(3, full=False)
    assert studio.next() == (3, True)


def test_a_renderer_that_fails_to_be_made_in_an_unknown_way_is_made_again() -> None:
    made: queue.Queue[MadePicture] = queue.Queue()
    thread = Pictures(lambda: 1 // 0, made.put)  # type: ignore[arg-type, return-value]
    for _ in range(2):
        thread.want(Wanted(Scene(plate="plate.png"), 1, 0, "composite", 512))
        assert "ZeroDivisionError" in made.get(timeout=WAIT_S).problems[0]
        with pytest.raises(ZeroDivisionError):
            thread.ask(lambda _: None).result(WAIT_S)
    thread.close()


def test_jobs_run_beside_pictures_and_give_their_errors(studio: Studio) -> None:
    assert studio.pictures.ask(lambda renderer: renderer is studio).result(WAIT_S)
    with pytest.raises(ZeroDivisionError):
        studio.pictures.ask(lambda _: 1 // 0).result(WAIT_S)


def test_urgent_jobs_come_before_pictures_that_are_then_made(studio: Studio) -> None:
    studio.want(1)
    assert studio.begun.get(timeout=WAIT_S) == 1
    late = studio.pictures.ask(lambda _: studio.made.qsize())
    soon = studio.pictures.ask(lambda _: studio.made.qsize(), urgent=True)
    studio.want(2)
    studio.gate.release(3)
    assert soon.result(WAIT_S) == 1
    assert late.result(WAIT_S) == 3
    assert [studio.next() for _ in range(3)] == [(1, True), (2, True), (2, False)]


def test_jobs_that_are_left_at_the_end_are_cancelled(studio: Studio) -> None:
    studio.want(1)
    assert studio.begun.get(timeout=WAIT_S) == 1
    left = studio.pictures.ask(lambda _: 1)
    closing = threading.Thread(target=studio.pictures.close)
    closing.start()
    while not studio.pictures._closed:  # only then may the picture end
        pass
    studio.gate.release(1)
    closing.join(WAIT_S)
    assert left.cancelled()


def test_stored_pictures_stay_until_they_are_dropped(studio: Studio) -> None:
    studio.gate.release(2)
    number = studio.pictures.store(b"thumb")
    assert studio.pictures.get(number) == b"thumb"
    studio.pictures.drop(number)
    assert studio.pictures.get(number) is None
    studio.want(1, full=False)
    assert studio.made.get(timeout=WAIT_S).number == number + 1


def test_few_pictures_are_kept(studio: Studio) -> None:
    studio.gate.release(200)
    numbers = []
    for revision in range(60):
        studio.want(revision, full=False)
        numbers.append(studio.made.get(timeout=WAIT_S).number)
    assert studio.pictures.get(numbers[0]) is None
    assert studio.pictures.get(numbers[-1]) is not None


def test_a_renderer_that_cannot_be_made_is_told() -> None:
    made: queue.Queue[MadePicture] = queue.Queue()

    def make() -> Studio:
        raise VideoError("no renderer")

    thread = Pictures(make, made.put)
    thread.want(Wanted(Scene(plate="plate.png"), 1, 0, "composite", 512))
    assert made.get(timeout=WAIT_S).problems == ("no renderer",)
    with pytest.raises(VideoError):
        thread.ask(lambda _: None).result(WAIT_S)
    thread.close()
