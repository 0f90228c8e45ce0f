# SPDX-License-Identifier: Apache-2.0
"""The demo as an ordinary camera sees it: python samples/demo/pictures.py COMPOSITE FOLDER.

Writes still.png, the composite, and wipe.png, the same with the plate right of a line.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import mr360uw as uw
from mr360uw.base.color import encode
from mr360uw.preview.screen import look, perspective
from mr360uw.types import Floats, View

HERE = Path(__file__).resolve().parent
VIEW = perspective(yaw_deg=-2.0, pitch_deg=-8.0, fov_deg=100.0, width=800, height=450)
"""Has about as many pixels to a degree as the clip."""
WIPE = 0.7
"""Where composite and plate meet, as a fraction of the width: before the whale's flukes."""


def first_view(path: Path, view: View) -> Floats:
    """Return a view into the first frame of a video, linear light."""
    with uw.open_video(path) as video:
        return look(next(video.frames()).image_linear, view)


def wiped(composite: Floats, plate: Floats) -> Floats:
    """Return the composite left of a white line, and the plate right of it."""
    both, line = composite.copy(), int(WIPE * composite.shape[1])
    both[:, line:] = plate[:, line:]
    both[:, line - 1 : line + 1] = 1.0
    return both


def picture(light: Floats) -> Image.Image:
    """Return linear light (H, W, 3), 1 = white, as a picture."""
    return Image.fromarray(np.round(255.0 * encode(np.clip(light, 0.0, 1.0), "srgb")).astype(np.uint8))


def main(composite: Path, folder: Path) -> None:
    """Write the composite's first frame, and the same with the plate in its right part."""
    seen = first_view(composite, VIEW)
    picture(seen).save(folder / "still.png")
    picture(wiped(seen, first_view(HERE / "dive.mp4", VIEW))).save(folder / "wipe.png")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3])) if len(sys.argv) == 3 else sys.exit(__doc__)
