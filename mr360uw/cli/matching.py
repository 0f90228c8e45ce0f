# SPDX-License-Identifier: Apache-2.0
"""The command `match`: fits of a scene to its plate, as lines of text."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mr360uw.cli.arguments import frame_range
from mr360uw.errors import ParameterError
from mr360uw.files import write_whole
from mr360uw.output_gate import check_outputs
from mr360uw.progress import Progress
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import Scene, files_of, load_scene

if TYPE_CHECKING:
    from mr360uw.match import WaterPatch


def match_lines(
    path: Path,
    *,
    caustics: bool,
    water: str | None,
    frames: str | None,
    picture: Path | None,
    overrides: Sequence[str],
    overwrite: bool,
    progress: Progress | None,
) -> list[str]:
    """Return what a match found: a sentence, and the changes as `--set` takes them. Raises `ParameterError`."""
    if caustics == (water is not None):
        raise ParameterError("match - fits one thing at a time (got both or none) - give --caustics or --water")
    scene = load_scene(path, overrides)
    if water is not None:
        from mr360uw.match import match_water

        found = match_water(scene, _patch(water), _frames(scene, frames) or 0)
        codes = "; ".join(
            f"{name} {np.round(code).astype(int).tolist()}"
            for name, code in (("plate", found.plate_code), ("before", found.before_code), ("after", found.after_code))
        )
        return [found.sentence, f"code values: {codes}", *(f"--set {change}" for change in found.overrides)]
    from mr360uw.match import match_caustics

    if picture is not None:
        _check_picture(scene, picture, overwrite=overwrite)
    match = match_caustics(scene, _frames(scene, frames), progress=progress)
    lines = [match.sentence, f"confidence {match.confidence:.2f}", *(f"--set {change}" for change in match.overrides)]
    pictures = match.pictures()
    if picture is not None and pictures:
        from mr360uw.preview.thumbnail import encoded

        write_whole(picture, encoded(np.concatenate([pictures["floor"], pictures["spectra"]]), ".png"))
        lines.append(f"wrote {picture}")
    return lines


def _check_picture(scene: Scene, picture: Path, *, overwrite: bool) -> None:
    if picture.suffix.lower() != ".png":
        raise ParameterError(f"--picture - is no name of a PNG (got {picture}) - end it in .png")
    check_outputs([picture], inputs=files_of(scene), overwrite=overwrite)


def _patch(text: str) -> WaterPatch:
    """Return the patch of 'yaw,pitch,size'."""
    from mr360uw.match import WaterPatch as Patch

    try:
        yaw, pitch, size = (float(part) for part in text.split(","))
    except ValueError:
        raise ParameterError(
            f"--water - is no patch (got {text!r}) - write yaw,pitch,size in degrees, as in 120,5,15"
        ) from None
    return Patch(yaw, pitch, size)


def _frames(scene: Scene, text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    start, stop = frame_range(text)
    with open_plate(scene) as video:
        return video.check_range(start, stop)
