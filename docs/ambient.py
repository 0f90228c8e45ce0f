# SPDX-License-Identifier: Apache-2.0
"""The pictures of docs/ambient.md: two bodies on a floor below an even sky, as parts of their ambient light are added.

python docs/ambient.py   # writes docs/ambient.jpg
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

import mr360uw as uw
from mr360uw.color import encode
from mr360uw.preview.still import Perspective, look
from mr360uw.types import Floats

DOCS = Path(__file__).resolve().parent
VIEW = Perspective(yaw_deg=0.0, pitch_deg=-27.0, fov_deg=50.0, width=400, height=300)
SCENE = """
[plate]
path = "plate.exr"
[water]
type = "none"
[light]
sun = "none"
[receiver]
height_m = -1.2
[[object]]
mesh = "crate.ply"
position_m = [-0.35, -0.8, -2.4]
rotation_deg = [25.0, 0.0, 0.0]
base_color = [0.8, 0.12, 0.08]
[[object]]
mesh = "ball.ply"
position_m = [0.45, -0.85, -2.2]
base_color = [0.75, 0.75, 0.75]
"""
ALONE = ("draw.ambient_occlusion=false", "receiver.occlusion=false")
BLACK = ("object.0.base_color=[0.0,0.0,0.0]",)


def plate() -> Floats:
    """Return a panorama (512, 1024, 3): an even sky of radiance 1 over a floor of albedo 0.35."""
    light = np.ones((512, 1024, 3), np.float32)
    light[256:] = 0.35
    return light


def main() -> None:
    """Write the sheet: bodies alone, then together, then with the floor, what that changes, what the crate sends."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        uw.video.write_exr(folder / "plate.exr", plate())
        trimesh.creation.box((0.8, 0.8, 0.8)).export(folder / "crate.ply")
        trimesh.creation.icosphere(4, 0.35).export(folder / "ball.ply")
        (folder / "scene.toml").write_text(SCENE, "utf-8")

        def seen(*overrides: str) -> Floats:
            scene = uw.load_scene(folder / "scene.toml", overrides)
            return look(uw.render_frame(plate(), scene).image_linear, VIEW)

        alone, whole, floor_bare = seen(*ALONE), seen(), seen("receiver.occlusion=false")
        sent_back = np.abs(whole - seen(*BLACK))
        sheet = [alone, floor_bare, whole, 0.5 + 0.5 * (whole - alone), 4.0 * sent_back]
        codes = [np.round(255 * encode(np.clip(one, 0.0, 1.0), "srgb")).astype(np.uint8) for one in sheet]
        Image.fromarray(np.concatenate(codes, axis=1)).save(DOCS / "ambient.jpg", quality=88)


if __name__ == "__main__":
    main()
