# SPDX-License-Identifier: Apache-2.0
"""Pictures of the demo.

python samples/demo/pictures.py look COMPOSITE FOLDER     # still.png and wipe.png: as an ordinary camera sees it
python samples/demo/pictures.py readme                   # docs/demo.jpg and docs/demo.webp, three minutes on two cores
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

import mr360uw as uw
from mr360uw.color import encode
from mr360uw.preview.still import Perspective, look
from mr360uw.sample import DiveSettings, sample_dive
from mr360uw.types import Floats

HERE = Path(__file__).resolve().parent
DOCS = HERE.parents[1] / "docs"
DIVE = {
    "depth_m": 3.0, "floor_m": 7.0, "wind_m_s": 4.0, "sun_azimuth_deg": -125.0, "sun_elevation_deg": 52.0, "seed": 41,
    "solid": True, "sand_albedo": 0.48, "rocks": 0.03, "grass": 0.03, "stops": 2.5,
}  # fmt: skip
"""That of the folder's clip, see README.md."""
EMPTY = [
    "shafts.mode=auto", "shafts.on_plate=true", "snow.amount=1",
    "object.0.visible=false", "object.0.casts_shadow=false",
]  # fmt: skip
"""Changes of the scene that draw what is in the water of the plate."""
VIEW = Perspective(yaw_deg=-2.0, pitch_deg=-10.0, fov_deg=100.0, width=800, height=450)
"""Has about as many pixels to a degree as the clip."""
SMALL = replace(VIEW, width=480, height=270)


def frames(path: Path, view: Perspective, count: int) -> list[Floats]:
    """Return views into the first frames of a video, codes from 0 to 255."""
    with uw.open_video(path) as video:
        return [_codes(look(frame.image_linear, view)) for frame in video.frames(0, count)]


def still_and_wipe(composite: Path, folder: Path) -> None:
    """Write the first frame, and the same with the plate left of a white line through the middle."""
    plate, picture = frames(HERE / "dive.mp4", VIEW, 1)[0], frames(composite, VIEW, 1)[0]
    Image.fromarray(picture).save(folder / "still.png")
    middle = VIEW.width // 2
    picture[:, :middle] = plate[:, :middle]
    picture[:, middle - 1 : middle + 1] = 255
    Image.fromarray(picture).save(folder / "wipe.png")


def readme() -> None:
    """Write the plate beside the composite, of a frame three times as wide as the demo's, and the demo as a loop."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        dive = DiveSettings.of(**DIVE)
        wide = sample_dive(folder, dive, width=3 * 1024, frames=1, overwrite=True)
        wide.scene.write_bytes((HERE / "scene.toml").read_bytes())
        uw.composite_video(uw.load_scene(wide.scene, EMPTY), folder / "plate.mp4")
        shutil.copy(folder / "plate.mp4", wide.plate)
        uw.composite_video(uw.load_scene(wide.scene), folder / "wide.mp4")
        pair = [frames(path, VIEW, 1)[0] for path in (wide.plate, folder / "wide.mp4")]
        Image.fromarray(np.concatenate(pair, axis=1)).save(DOCS / "demo.jpg", quality=88)
        uw.composite_video(uw.load_scene(HERE / "scene.toml"), folder / "loop.mp4")
        loop = [Image.fromarray(picture) for picture in frames(folder / "loop.mp4", SMALL, 24)]
        # there and back again, so that it has no jump
        first, *rest = loop + loop[-2:0:-1]
        first.save(DOCS / "demo.webp", save_all=True, append_images=rest, duration=42, loop=0, quality=55)


def _codes(light: Floats) -> Floats:
    return np.round(255.0 * encode(np.clip(light, 0.0, 1.0), "srgb")).astype(np.uint8)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["look", composite, folder]:
            still_and_wipe(Path(composite), Path(folder))
        case ["readme"]:
            readme()
        case _:
            sys.exit(__doc__)
