# SPDX-License-Identifier: Apache-2.0
"""Compares what a grey card would be at an object's place with what is around it in the plate."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from mr360uw.color import luminance
from mr360uw.composite.object_settings import ObjectSettings
from mr360uw.preview.drafts import COARSE_WIDTH
from mr360uw.preview.live import LivePreview
from mr360uw.scene.model import Scene

_GREY = 0.18
"""Reflectance of a grey card, and about that of most ground."""
_THIN = 0.01
"""Thickness of the card over its side."""
_WHOLE = 0.95
"""Alpha from which a pixel shows the card alone."""
_FEWEST = 12
"""Pixels of the card below which nothing is told."""
_DARKEST = 1e-4
"""Light that counts as black."""


def grey_card_stops(live: LivePreview, draft: Scene) -> float | None:
    """Return by how many stops a grey card in the place of a draft's object is brighter than the plate around it.

    Where the object stands the card lies on the ground, else it faces the camera. None where it is not seen.
    """
    import trimesh

    body = draft.objects[0]
    lies = body.stand_on is not None
    with TemporaryDirectory() as folder:
        path = Path(folder) / "card.ply"
        trimesh.creation.box((1.0, _THIN, 1.0) if lies else (1.0, 1.0, _THIN)).export(path)
        card = ObjectSettings(
            mesh=path, size_m=body.size_m, azimuth_deg=body.azimuth_deg, elevation_deg=body.elevation_deg,
            distance_m=body.distance_m, stand_on=body.stand_on, face="camera", casts_shadow=False,
            base_color=(_GREY, _GREY, _GREY), metallic=0.0, roughness=1.0,
        )  # fmt: skip
        frame = live.frame(draft.model_copy(update={"objects": (card,)}), 0, COARSE_WIDTH)
    inside = frame.layer.alpha > _WHOLE
    if int(inside.sum()) < _FEWEST:
        return None
    seen, plate = (luminance(picture.image_linear) for picture in (frame.picture, frame.plate))
    shown, around = float(np.mean(seen[inside])), float(np.median(plate[_rim(inside)]))
    return float(np.log2(max(shown, _DARKEST) / max(around, _DARKEST)))


def _rim(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels around some (h, w) of a panorama, about as far out as those reach."""
    import cv2

    reach = max(3, round(np.sqrt(int(inside.sum())) / 2))
    wide = np.pad(inside.astype(np.uint8), ((0, 0), (reach, reach)), mode="wrap")
    outer, inner = (cv2.dilate(wide, np.ones((2 * r + 1, 2 * r + 1), np.uint8)) for r in (reach, 1))
    return np.asarray((outer > inner)[:, reach:-reach])
