# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json

import cv2
import numpy as np
import OpenEXR
import pytest

from mr360uw.caustics import CausticSettings, export_tiles
from mr360uw.caustics.export import CAUSTIC_WHITE, world_grid
from mr360uw.errors import OutputExistsError, ParameterError
from tests.caustics import tolerances as tol
from tests.caustics.seas import SEAS

SMALL = CausticSettings(size=32, grid=32)
SUN = (0.2, 1.0, 0.1)


def test_png_and_exr_hold_the_same_maps(tmp_path):
    png = export_tiles(SEAS["gerstner"], SUN, 2.0, tmp_path / "png", 2, 4.0, SMALL)
    exr = export_tiles(SEAS["gerstner"], SUN, 2.0, tmp_path / "exr", 2, 4.0, SMALL, "exr")
    assert len(png) == len(exr) == 3 * 2 + 1
    assert not list(tmp_path.rglob(".partial*"))
    about = json.loads((tmp_path / "png" / "tiles.json").read_text())
    decode = {
        "caustic": lambda v: v * CAUSTIC_WHITE,
        "height": lambda v: (v - 0.5) * 2.0 * about["height_range_m"],
        "normal": lambda v: 2.0 * v - 1.0,
    }
    scale = {"caustic": CAUSTIC_WHITE, "height": about["height_range_m"], "normal": 1.0}
    for name, back in decode.items():
        codes = cv2.imread(str(tmp_path / "png" / f"{name}_0001.png"), cv2.IMREAD_UNCHANGED)
        assert codes.dtype == np.uint16
        image = back(codes[..., ::-1] / 65535.0 if codes.ndim == 3 else codes / 65535.0)
        with OpenEXR.File(str(tmp_path / "exr" / f"{name}_0001.exr")) as file:
            channels = file.channels()
            exact = channels["RGB" if "RGB" in channels else "Y"].pixels
        np.testing.assert_allclose(image, np.minimum(exact, scale[name]), atol=tol.SIXTEEN_BIT * scale[name])


def test_the_world_grid_undoes_the_shift():
    sea = SEAS["jonswap"]
    height, normal = world_grid(sea, 64, 0.7)
    surface = sea.grid_surface(512, 0.7)
    x, z = (surface.position[..., i] % sea.tile_m * 64 / sea.tile_m for i in (0, 2))
    near = (np.abs(x % 1.0 - 0.5) < 0.05) & (np.abs(z % 1.0 - 0.5) < 0.05)
    assert near.sum() > 50
    at = z[near].astype(int), x[near].astype(int)
    np.testing.assert_allclose(height[at], surface.position[..., 1][near], atol=tol.WORLD_GRID)
    np.testing.assert_allclose(normal[at], surface.normal[near], atol=tol.WORLD_GRID)


def test_frames_divide_the_loop_and_normals_have_up_last(tmp_path):
    export_tiles(SEAS["gerstner"], SUN, 2.0, tmp_path, 4, 4.0, SMALL, "exr")
    height, normal = world_grid(SEAS["gerstner"].model_copy(update={"loop_s": 4.0}), SMALL.size, 1.0)
    for name, channels, wanted in (("height", "Y", height), ("normal", "RGB", normal[..., [0, 2, 1]])):
        with OpenEXR.File(str(tmp_path / f"{name}_0001.exr")) as file:
            np.testing.assert_allclose(file.channels()[channels].pixels, wanted, atol=tol.FLOAT32)


def test_nothing_is_overwritten_without_being_asked(tmp_path):
    export_tiles(SEAS["gerstner"], SUN, 2.0, tmp_path, 1, 4.0, SMALL)
    with pytest.raises(OutputExistsError):
        export_tiles(SEAS["gerstner"], SUN, 2.0, tmp_path, 1, 4.0, SMALL)
    export_tiles(SEAS["gerstner"], SUN, 2.0, tmp_path, 1, 4.0, SMALL, overwrite=True)


@pytest.mark.parametrize("changes", [{"frames": 0}, {"loop_s": 0.0}, {"loop_s": np.nan}, {"image_format": "tiff"}])
def test_arguments_outside_their_domain(tmp_path, changes):
    with pytest.raises(ParameterError):
        export_tiles(SEAS["gerstner"], SUN, 2.0, tmp_path, **({"frames": 1, "settings": SMALL} | changes))
