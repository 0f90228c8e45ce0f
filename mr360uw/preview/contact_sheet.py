# SPDX-License-Identifier: Apache-2.0
"""Variants of a scene side by side, as one labelled picture and as a page."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import ParameterError
from mr360uw.files import write_whole
from mr360uw.output_gate import check_outputs
from mr360uw.preview.live import LivePreview
from mr360uw.preview.still import Still, still_of
from mr360uw.preview.thumbnail import encoded
from mr360uw.progress import Progress
from mr360uw.reading.input_files import files_read
from mr360uw.scene.model import at_scale, files_of, load_scene
from mr360uw.video.write.image_writer import picture_codes

LARGEST_SHEET = 64
"""Pictures on a sheet, at most."""
_COLUMNS = 4
_CELL_WIDTH = 640
_LABEL_ROWS, _GAP = 26, 4
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; background: #181818; color: #ebebeb; margin: 1.5em; }
h1 { font-size: 1.3em; } main { display: flex; flex-wrap: wrap; gap: 1em; } figure { margin: 0; flex: 1 1 400px; }
img { width: 100%; display: block; } figcaption { padding: .3em 0; font-family: ui-monospace, monospace; }
"""


Variant = tuple[str, NDArray[np.uint8]]
"""A picture of a scene with some keys changed: the changes in words, and codes (h, w, 3)."""


def sweep(
    scene: Path,
    out: Path,
    changes: Sequence[tuple[str, ...]],
    still: Still = still_of,
    *,
    scale: float | None = None,
    backend: str = "auto",
    overwrite: bool = False,
    progress: Progress | None = None,
) -> list[Path]:
    """Render one frame of a scene file with each set of overrides; write a labelled sheet and a page, return the paths.

    out: a PNG or JPEG; the page goes beside it as .html and holds its pictures. changes: overrides of each variant, as
    `load_scene` takes them; all are checked before the first is rendered. still: which frame and view is shown. scale:
    size of the frames over the plate's. Raises what `still_of` raises, `ParameterError` for more than `LARGEST_SHEET`
    variants.
    """
    if len(changes) > LARGEST_SHEET:
        raise ParameterError(
            f"--set - makes too many pictures (got {len(changes)}) - leave values out until there are {LARGEST_SHEET}"
        )
    if out.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise ParameterError(f"{out} - is no name of a sheet (got {out.suffix!r}) - end it in .png or .jpg")
    page = out.with_suffix(".html")
    scenes = [at_scale(load_scene(scene, overrides), scale) for overrides in changes]
    check_outputs([out, page], inputs=[scene, *files_of(scenes[0])], overwrite=overwrite)
    found = []
    with files_read() as read, LivePreview(backend) as live:
        for number, (one, overrides) in enumerate(zip(scenes, changes, strict=True), 1):
            picture = still(live, one)
            found.append(("  ".join(overrides) or scene.name, _small(picture_codes(picture, deep=False))))
            if progress is not None:
                progress(number, len(scenes))
    check_outputs([out, page], inputs=read, overwrite=overwrite)
    write_whole(out, encoded(contact_sheet(found), out.suffix))
    write_whole(page, contact_page(scene.name, found))
    return [out, page]


def contact_sheet(variants: Sequence[Variant]) -> NDArray[np.uint8]:
    """Return variants in rows of up to four, (h, w, 3) uint8, each with its label below."""
    import cv2

    cell = np.max([codes.shape[:2] for _, codes in variants], axis=0) + np.array([_LABEL_ROWS + _GAP, _GAP])
    columns = min(_COLUMNS, len(variants))
    sheet = np.full((-(-len(variants) // columns) * cell[0] + _GAP, columns * cell[1] + _GAP, 3), 24, np.uint8)
    for number, (words, codes) in enumerate(variants):
        row, column = _GAP + cell[0] * (number // columns), _GAP + cell[1] * (number % columns)
        height, width = codes.shape[:2]
        sheet[row : row + height, column : column + width] = codes
        label = words.encode("ascii", "replace").decode()
        (length, _), _ = cv2.getTextSize(label, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 1)
        size = min(0.55, (width - 2 * _GAP) / max(length, 1))
        place = int(column + _GAP), int(row + height + _LABEL_ROWS - 8)
        cv2.putText(sheet, label, place, cv2.FONT_HERSHEY_SIMPLEX, size, (235, 235, 235), 1, cv2.LINE_AA)
    return sheet


def contact_page(title: str, variants: Sequence[Variant]) -> str:
    """Return a page (HTML, complete in itself) of variants with their labels."""
    figures = "\n".join(
        f'<figure><img alt="{html.escape(label)}" src="data:image/png;base64,'
        f'{base64.b64encode(encoded(codes, ".png")).decode()}"><figcaption>{html.escape(label)}</figcaption></figure>'
        for label, codes in variants
    )
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title><style>{_STYLE}</style></head>
<body><h1>{html.escape(title)}</h1>
<main>
{figures}
</main></body></html>
"""


def _small(codes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    import cv2

    height, width = codes.shape[:2]
    if width <= _CELL_WIDTH:
        return codes
    size = (_CELL_WIDTH, max(1, round(height * _CELL_WIDTH / width)))
    return np.asarray(cv2.resize(codes, size, interpolation=cv2.INTER_AREA), np.uint8)
