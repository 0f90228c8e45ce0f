# SPDX-License-Identifier: Apache-2.0
"""One sun for a shot: robust to waves, the same in every frame; a slow path where the camera turns."""

from __future__ import annotations

import numpy as np
import pytest

import mr360uw.ibl as ibl
from mr360uw.base.constants import REFRACTIVE_INDEX_SEA
from mr360uw.base.optics import critical_cosine, refract_to_water
from mr360uw.base.sphere import direction_from_angles, directions, unit
from mr360uw.ibl.plate import LinearPlate
from mr360uw.ibl.sun.detect import glitter_middle
from mr360uw.surface.facet_draws import glitter
from mr360uw.surface.ray_kernel import disc_of
from mr360uw.types import Sun
from tests.ibl.plates import angle_deg, clipped
from tests.ibl.tolerances import FLOAT64, GLITTER_DEG, STEADY_DEG, STEADY_PATH_DEG

RATE = 24.0


def waves(rng: np.random.Generator, frames: int, size_deg: float = 1.2) -> np.ndarray:
    """Return what waves add to a direction (n, 3): three periods of 1 to 3 s, and some outliers."""
    t = np.arange(frames) / RATE
    offset = np.zeros((frames, 3))
    for period in (1.0, 1.7, 3.0):
        phase = rng.uniform(0.0, 2.0 * np.pi, 3)
        offset += np.sin(2.0 * np.pi * t[:, None] / period + phase)
    offset *= np.radians(size_deg) / np.sqrt(3.0)
    lost = rng.random(frames) < 0.08
    return offset + lost[:, None] * rng.normal(0.0, 0.2, (frames, 3))


def measured(direction: np.ndarray) -> list[Sun]:
    return [Sun(unit(d), np.full(3, 2.0, np.float32), 0.01, 0.9) for d in direction]


@pytest.mark.parametrize("frames", [48, 240])
def test_a_standing_camera_has_one_sun(rng: np.random.Generator, frames: int) -> None:
    true = direction_from_angles(0.7, 1.0)
    for _ in range(6):
        times = np.arange(frames) / RATE
        track = ibl.track_suns(measured(true + waves(rng, frames)), times)
        assert np.ptp(track.direction, axis=0).max() == 0.0
        assert angle_deg(track.direction[0], true) < STEADY_DEG


def test_a_turning_camera_is_followed_slowly(rng: np.random.Generator) -> None:
    frames = 360
    azimuth = np.radians(np.linspace(0.0, 40.0, frames))
    true = np.stack([direction_from_angles(a, 0.9) for a in azimuth])
    suns = measured(true + waves(rng, frames))
    times = np.arange(frames) / RATE
    track = ibl.track_suns(suns, times)
    error = np.degrees(np.arccos(np.clip((track.direction * true).sum(axis=1), -1.0, 1.0)))
    assert np.sqrt((error**2).mean()) < STEADY_PATH_DEG
    level = ibl.track_suns(suns, times, camera="levelled")
    assert np.ptp(level.direction[:, 1]) < FLOAT64
    assert np.ptp(level.direction[:, 0]) > 0.3
    assert angle_deg(level.direction[200], true[200]) < 2.0 * STEADY_PATH_DEG


def test_a_tracked_camera_has_one_sun_whatever_is_measured(rng: np.random.Generator) -> None:
    drift = np.stack([direction_from_angles(a, 0.9) for a in np.radians(np.linspace(-6.0, 6.0, 200))])
    suns, times = measured(drift + waves(rng, 200)), np.arange(200) / RATE
    fixed = ibl.track_suns(suns, times, camera="tracked")
    assert np.ptp(fixed.direction, axis=0).max() == 0.0
    assert np.ptp(ibl.track_suns(suns, times).direction, axis=0).max() > 0.1


@pytest.mark.parametrize(("elevation_deg", "slope"), [(60.0, 0.08), (75.0, 0.1), (85.0, 0.15)])
def test_the_middle_of_a_glitter_is_that_of_the_slopes(elevation_deg: float, slope: float) -> None:
    """A clipped sun through facets of random slopes: the middle of its directions is not where the sun is."""
    air = direction_from_angles(0.4, np.radians(elevation_deg))
    sun, seen = refract_to_water(air), directions(256, 128)
    ray = seen[seen[..., 1] > 0.02]
    level, covariance = np.tile([0.0, 1.0, 0.0], (len(ray), 1)), np.tile([slope**2, 0.0, slope**2], (len(ray), 1))
    disc, _ = disc_of(Sun(air, np.full(3, 20.0), 0.00465, 1.0))
    light = np.where(seen[..., 1] > critical_cosine(REFRACTIVE_INDEX_SEA), 0.4, 0.05)
    light[seen[..., 1] > 0.02] += disc.red * glitter(disc, ray, level, covariance, -1.0, REFRACTIVE_INDEX_SEA)
    plate = LinearPlate(clipped(np.repeat(light[..., None], 3, axis=2).astype(np.float32)))
    beside = unit(sun + np.array([0.03, 0.0, 0.03]))
    assert angle_deg(glitter_middle(plate, beside), sun) < GLITTER_DEG
    dark = LinearPlate(np.zeros((64, 128, 3), np.float32))
    np.testing.assert_array_equal(glitter_middle(dark, sun), sun)
