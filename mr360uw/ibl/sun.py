# SPDX-License-Identifier: Apache-2.0
"""The sun in a plate, clipped or not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.color import luminance
from mr360uw.ibl.expansion import checked_plate, snell_elevation
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS, LinearPlate, Plate
from mr360uw.ibl.tangent import patch_directions, patch_solid_angle
from mr360uw.sphere import directions, unit
from mr360uw.types import Floats, Sun


@dataclass(frozen=True, slots=True)
class Disc:
    """Where the sun is and how much light it adds to its surroundings, before any expansion.

    direction: (3,) unit. half_angle_rad: radius of the brightest part as it is seen. threshold: luminance above
    which light is the sun's. confidence: 0 to 1.
    """

    direction: Floats
    half_angle_rad: float
    threshold: float
    confidence: float


def find_disc(plate: Plate, *, underwater: bool = False) -> Disc | None:
    """Return the most likely sun of a plate, None where nothing stands out."""
    up = directions(COARSE_COLUMNS, COARSE_ROWS)[..., 1]
    allowed = up > np.sin(snell_elevation() if underwater else 0.0)
    bright = np.where(allowed, plate.brightest, 0.0)
    peak = float(bright.max())
    if peak <= 0.0 or peak <= 1.5 * float(np.median(plate.brightest)):
        return None
    mask = bright >= 0.9 * peak
    d = directions(COARSE_COLUMNS, COARSE_ROWS)[mask]
    weight = luminance(plate.coarse)[mask]
    centre = unit(d[int(weight.argmax())])
    radius = np.radians(8.0)
    for _ in range(3):
        look = patch_directions(centre, radius, 129)
        solid_angle = patch_solid_angle(radius, 129)
        values = luminance(plate.look(look))
        threshold = 0.5 * float(values.max())
        excess = np.maximum(values - threshold, 0.0) * solid_angle * (look[..., 1] > 0.0)
        if excess.sum() <= 0.0:
            return None
        centre = unit(np.tensordot(excess, look, ([0, 1], [0, 1])))
    disc = float(solid_angle[values > threshold].sum())
    half_angle = float(np.arccos(np.clip(1.0 - disc / (2.0 * np.pi), -1.0, 1.0)))
    return Disc(centre, half_angle, threshold, float(np.clip(1.5 - half_angle / np.radians(4.0), 0.0, 1.0)))


def sun_of_disc(plate: Plate, disc: Disc) -> Sun:
    """Return the sun whose irradiance is the light above the disc's threshold near it."""
    radius = max(3.0 * disc.half_angle_rad, np.radians(1.0))
    look = patch_directions(disc.direction, radius, 129)
    colour = plate.look(look)
    value = np.maximum(luminance(colour), 1e-6)
    excess = colour * np.maximum(1.0 - disc.threshold / value, 0.0)[..., None]
    energy = np.tensordot(patch_solid_angle(radius, 129), excess, ([0, 1], [0, 1]))
    return Sun(disc.direction, energy.astype(np.float32), disc.half_angle_rad, disc.confidence)


def detect_sun(plate: ArrayLike, underwater: bool = False) -> Sun | None:
    """Return the sun of a linear plate (H, W, 3), HDR or clipped; None where there is none."""
    seen = LinearPlate.of(checked_plate(plate))
    disc = find_disc(seen, underwater=underwater)
    return None if disc is None else sun_of_disc(seen, disc)
