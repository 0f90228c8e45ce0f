# SPDX-License-Identifier: Apache-2.0
"""Decoders of graphics cards: taken where their first picture is that of the software, and said; software elsewhere.

No card is needed: what FFmpeg is told of a device is replaced, so that the pretended card decodes in software, and its
pictures are repacked as cards have them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw import open_video
from mr360uw.errors import VideoError
from mr360uw.video import container
from tests.video.clips import write_clip

FRAMES = 5


@pytest.fixture
def cards(monkeypatch: pytest.MonkeyPatch) -> dict[str, Callable[[Any], Any]]:
    """Cards by name, each with what it makes of a picture; fill it in."""
    known: dict[str, Callable[[Any], Any]] = {}
    opened = container.open_container

    @contextmanager
    def pretended(path: Path, track: int = 0, card: str = "") -> Iterator[tuple[Any, Any]]:
        with opened(path, track) as (inside, stream):
            yield (_Decoding(inside, known[card]) if card else inside), stream

    monkeypatch.setattr(container, "hwdevices_available", lambda: list(known))
    monkeypatch.setattr(container, "open_container", pretended)
    return known


class _Decoding:
    """A container whose pictures are changed."""

    def __init__(self, inside: Any, change: Callable[[Any], Any]) -> None:
        self._inside, self._change = inside, change

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inside, name)

    def decode(self, *given: Any, **named: Any) -> Iterator[Any]:
        return map(self._change, self._inside.decode(*given, **named))


def in_pairs(picture: Any) -> Any:
    changed = picture.reformat(format="nv12")
    changed.pts, changed.time_base = picture.pts, picture.time_base
    return changed


def brighter(picture: Any) -> Any:
    codes = picture.to_ndarray()
    codes[3, 3] ^= 1
    changed = type(picture).from_ndarray(codes, format=picture.format.name)
    changed.pts, changed.time_base = picture.pts, picture.time_base
    return changed


def broken(_: Any) -> Any:
    raise VideoError("no session is free")


def planes(path: Path, decoder: Any) -> tuple[list[np.ndarray], tuple[str, ...]]:
    with open_video(path, decoder=decoder) as video:
        frames = [np.concatenate([p.ravel() for p in (f.yuv.y, f.yuv.u, f.yuv.v)]) for f in video.frames() if f.yuv]
        return frames, video.notes


def test_a_card_with_the_same_pictures_is_taken(tmp_path: Path, cards: dict[str, Callable[[Any], Any]]) -> None:
    path = write_clip(tmp_path / "in.mp4", FRAMES)
    plain, _ = planes(path, "software")
    cards |= {"broken": broken, "other": brighter, "good": in_pairs, "never": broken}
    found, notes = planes(path, "auto")
    assert 'plate.decoder = "auto" took good, whose first picture is the same' in notes
    assert len(found) == FRAMES
    for one, other in zip(found, plain, strict=True):
        np.testing.assert_array_equal(one, other)


def test_others_are_refused_with_the_reason(tmp_path: Path, cards: dict[str, Callable[[Any], Any]]) -> None:
    path = write_clip(tmp_path / "in.mp4", FRAMES)
    cards |= {"broken": broken, "other": brighter}
    found, notes = planes(path, "auto")
    assert len(found) == FRAMES
    refused = "broken: no session is free; other: its first picture differs"
    assert f'plate.decoder = "auto" took software: no card decodes in.mp4 here ({refused})' in notes


def test_the_report_of_a_run_says_which(
    tmp_path: Path, run: Callable[..., Any], cards: dict[str, Callable[[Any], Any]]
) -> None:
    write_clip(tmp_path / "plate.mp4", FRAMES)
    cards["good"] = in_pairs
    (tmp_path / "scene.toml").write_text('[plate]\npath = "plate.mp4"\ndecoder = "auto"\n', "utf-8")
    code, said, _ = run("composite", tmp_path / "scene.toml", tmp_path / "out.mp4", "--backend", "reference")
    assert code == 0
    assert 'note: plate.decoder = "auto" took good' in said


def test_devices_of_this_machine_decode_alike_or_are_refused(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "in.mp4", FRAMES)
    (found, notes), (plain, _) = planes(path, "auto"), planes(path, "software")
    assert sum("plate.decoder" in note for note in notes) == 1
    for one, other in zip(found, plain, strict=True):
        np.testing.assert_array_equal(one, other)
