# SPDX-License-Identifier: Apache-2.0
"""Exposure and tint: trims of the light that bodies send to the camera, and of nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mr360uw import render_frame
from mr360uw.types import Layer
from tests.composite import tolerances as tol
from tests.scenes import gradient_plate, scene_with


def test_trims_scale_what_the_camera_gets_of_a_body(tmp_path: Path, whale: Path, backend: str) -> None:
    """One stop in the light and one in the object are two; the veil, the shadow and the plate stay as they are."""
    plate = gradient_plate(96, 48, sun=(0.0, 0.9, -0.4))
    tables: dict[str, Any] = {"receiver": {"kind": "plane", "position_m": [0.0, -1.5, 0.0]}, "draw": {"samples": 5}}
    tint = np.array([1.0, 0.5, 0.25])

    def drawn(stops: float, **of_object: Any) -> Layer:
        scene = scene_with(tmp_path, whale, light={"sun": "given", "exposure": stops}, **tables)
        trimmed = scene.objects[0].model_copy(update=of_object)
        return render_frame(plate, scene.model_copy(update={"objects": (trimmed,)}), backend=backend).layer

    plain, dark, bright = drawn(0.0), drawn(0.0, tint=(0.0, 0.0, 0.0)), drawn(1.0, exposure=1.0, tint=tuple(tint))
    for one, veil, other in zip(plain.tiles, dark.tiles, bright.tiles, strict=True):
        body = one.radiance - veil.radiance
        assert body.max() > 10.0 * tol.TRIM or not one.alpha.any()
        np.testing.assert_allclose(other.radiance - veil.radiance, 4.0 * tint * body, atol=tol.TRIM)
        np.testing.assert_array_equal(other.alpha, one.alpha)
        np.testing.assert_array_equal(other.ratio, one.ratio)
