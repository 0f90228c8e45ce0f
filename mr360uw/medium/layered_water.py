# SPDX-License-Identifier: Apache-2.0
"""Water whose coefficients change with depth, as a scene's profile has them: layers that are waters of their own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mr360uw.base.cache import shared
from mr360uw.medium.layers import layer_means, read_profile
from mr360uw.medium.phase import Phase
from mr360uw.medium.water import Water, molecular_part


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LayeredWater(Water):
    """Water in layers; all that a `Water` has is that of the layer that a camera is in.

    top_m: (L,) depths [m] at which layers begin, the first 0. layers: (L,). here: number of the camera's.
    """

    top_m: tuple[float, ...] = (0.0,)
    layers: tuple[Water, ...] = ()
    here: int = 0


def layered_water(path: Path, like: Water, camera_depth_m: float) -> LayeredWater:
    """Return the water of a CSV file's profile, in the layers of `LayeredField.from_csv`, equal ones joined.

    like: gives the phase function of the particles, and whether molecules are told apart from them. Raises
    `ParameterError`.
    """
    depth, nm, a, b = read_profile(path)
    top, a, b = layer_means(depth, a, b, where=f"{path}, ")
    new = np.append(True, np.any(np.abs(np.diff([a, b], axis=1)) > _EQUAL, axis=(0, 2)))
    here = int(np.searchsorted(top[new], camera_depth_m, side="right")) - 1
    table = tuple(values.tobytes() for values in (top[new], nm, a[new], b[new]))
    return _layered(str(path), table, like.phase, like.molecular is not None, here)


_EQUAL = 1e-9
"""Difference of coefficients [1/m] up to which layers are one: the rounding of means."""


@shared(keep=16)
def _layered(path: str, table: tuple[bytes, ...], phase: Phase, molecules: bool, here: int) -> LayeredWater:
    top, nm, a, b = (np.frombuffer(values) for values in table)
    layers = []
    for depth, absorption, scattering in zip(top, a.reshape(len(top), -1), b.reshape(len(top), -1), strict=True):
        layer = Water.from_arrays(nm, absorption, scattering, None, phase, f"{Path(path).name} from {depth:g} m")
        layers.append(replace(layer, molecular=molecular_part(layer.b) if molecules else None, source=path))
    own, tops = layers[here], tuple(top.tolist())
    return LayeredWater(own.name, own.a, own.b, None, phase, own.molecular, path, tops, tuple(layers), here)
