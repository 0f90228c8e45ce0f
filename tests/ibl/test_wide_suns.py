# SPDX-License-Identifier: Apache-2.0
"""Suns of any size: one decision over radius, exposure and resolution; the sun among clipped clouds by its glow."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

import mr360uw.ibl as ibl
from mr360uw.base.sphere import direction_from_angles, directions, row_solid_angle, unit
from mr360uw.ibl.plate import LinearPlate
from mr360uw.ibl.settings import LightSettings
from mr360uw.ibl.sun.detect import find_disc, sun_found
from mr360uw.ibl.sun.spots import find_glow
from tests.ibl.panoramas import texture
from tests.ibl.plates import angle_deg, clipped
from tests.ibl.tolerances import GLOW_DEG, WIDE_SUN_DEG, WIDE_SUN_ENERGY, WIDE_SUN_RADIUS

TOWARDS = unit([0.3, 0.8, 0.2])
RADII_DEG = (0.25, 0.5, 1.0, 2.0, 5.0)


def disc(radius_deg: float, width: int, radiance: float = 3000.0) -> tuple[np.ndarray, float]:
    """Return a sky (H, W, 3) with a disc whose rim pixels are covered in part, and the irradiance of the disc."""
    fine = 8 if width < 2048 else 4
    d = directions(width, width // 2)
    sky = np.where(d[..., 1] > 0.0, 0.15 + 0.1 * d[..., 1], 0.05)
    away = np.arccos(np.clip(d @ TOWARDS, -1.0, 1.0))
    row, column = np.nonzero(away < np.radians(radius_deg + 1.5))
    part = (np.arange(fine) + 0.5) / fine
    longitude = 2.0 * np.pi * ((column[:, None, None] + part) / width - 0.5)
    latitude = np.pi * (0.5 - (row[:, None, None] + part[:, None]) / (width // 2))
    fall = np.cos(latitude) * (np.sin(longitude) * TOWARDS[0] - np.cos(longitude) * TOWARDS[2])
    covered = np.zeros_like(sky)
    covered[row, column] = (fall + np.sin(latitude) * TOWARDS[1] > np.cos(np.radians(radius_deg))).mean(axis=(1, 2))
    put = float((radiance * covered * row_solid_angle(width, width // 2)[:, None]).sum())
    return np.repeat((sky + radiance * covered)[..., None], 3, axis=2).astype(np.float32), put


@pytest.mark.parametrize("width", [512, 1024])
@pytest.mark.parametrize("radius_deg", RADII_DEG)
def test_an_unclipped_disc_is_the_sun_at_any_size_and_exposure(radius_deg: float, width: int) -> None:
    image, put = disc(radius_deg, width)
    pixel_deg = 360.0 / width
    for exposure in (1.0, 1e-2, 1e-4):
        sun = ibl.detect_sun(image * np.float32(exposure))
        assert sun is not None
        assert sun.confidence > 0.9
        assert angle_deg(sun.direction, TOWARDS) < WIDE_SUN_DEG
        np.testing.assert_allclose(sun.irradiance, put * exposure, rtol=WIDE_SUN_ENERGY)
        wanted = max(radius_deg, 0.5 * pixel_deg)
        assert np.degrees(sun.half_angle_rad) == pytest.approx(wanted, abs=WIDE_SUN_RADIUS * pixel_deg)


def test_a_spot_loses_confidence_with_contrast_and_never_comes_back() -> None:
    for radius_deg in RADII_DEG:
        found = [find_disc(LinearPlate(disc(radius_deg, 512, radiance)[0])) for radiance in (3e3, 300.0, 60.0, 3.0)]
        confidence = [0.0 if spot is None else spot.confidence for spot in found]
        assert confidence == sorted(confidence, reverse=True)
        assert confidence[0] > 0.9
        assert confidence[-1] < 0.5


@pytest.mark.parametrize("source", ["detect", "given"])
def test_a_disc_keeps_its_radius_however_it_is_known(source: str) -> None:
    chosen = LightSettings(operator="none")
    for radius_deg in (1.5, 4.0):
        image, put = disc(radius_deg, 1024)
        sun = ibl.environment(image, chosen, sun="detect" if source == "detect" else TOWARDS).sun
        assert sun is not None
        assert np.degrees(sun.half_angle_rad) == pytest.approx(radius_deg, abs=WIDE_SUN_RADIUS * 360.0 / 1024)
        np.testing.assert_allclose(sun.irradiance, put, rtol=WIDE_SUN_ENERGY)


def test_a_clipped_disc_shows_its_radius_and_glare_does_not() -> None:
    image, _ = disc(3.0, 1024)
    for sun in (ibl.detect_sun(clipped(image)), ibl.environment(clipped(image), sun=TOWARDS).sun):
        assert sun is not None
        assert np.degrees(sun.half_angle_rad) == pytest.approx(3.0, abs=360.0 / 1024)
    away = np.degrees(np.arccos(np.clip(directions(1024, 512) @ TOWARDS, -1.0, 1.0)))[..., None]
    for power in (2.0, 3.0):
        glare = (3.0 / np.maximum(away, 0.5)) ** power
        sun = ibl.detect_sun(clipped(disc(0.25, 1024)[0] + glare.astype(np.float32)))
        assert sun is not None
        assert np.degrees(sun.half_angle_rad) < 0.3


def test_two_lamps_are_no_sun() -> None:
    image, _ = disc(1.2, 1024)
    two = np.maximum(image, np.roll(image, 300, axis=1))
    found = find_disc(LinearPlate(two))
    assert found is not None
    assert found.confidence < 0.5
    assert "one of several" in found.reason


def cloudy(sun_glow: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a clipped sky with broken white clouds, one of them over the sun, and the sun's direction."""
    place = direction_from_angles(0.8, 0.95)
    d = directions(1024, 512)
    away = np.degrees(np.arccos(np.clip(d @ place, -1.0, 1.0)))[..., None]
    elevation = np.degrees(np.arcsin(d[..., 1]))[..., None]
    blue, white = np.array([0.1, 0.25, 0.6]), np.ones(3)
    sky = blue * (1.0 + 0.6 * np.exp(-elevation / 10.0)) + white * sun_glow * np.exp(-away / 12.0)
    cloud = (texture(d, 5, 4.0)[..., None] > 1.1) | ((away < 5.0) & (texture(d, 6, 9.0)[..., None] > -0.5))
    scene = np.where(elevation > 0.0, np.where(cloud & (elevation > 4.0), 1.3, sky), 0.1 * white)
    return clipped((scene + 3000.0 * (away < 0.3)).astype(np.float32)), place


def test_the_glow_of_the_sky_tells_which_cloud_hides_the_sun() -> None:
    plate, place = cloudy(0.9)
    seen = find_glow(LinearPlate(plate))
    assert seen is not None
    assert angle_deg(seen[0], place) < GLOW_DEG
    sun = ibl.detect_sun(plate)
    assert sun is not None
    assert sun.confidence > 0.5
    assert angle_deg(sun.direction, place) < GLOW_DEG


def test_clouds_without_a_glow_are_none_and_the_candidate_is_named() -> None:
    plate = LinearPlate(cloudy(0.0)[0])
    found = find_disc(plate)
    assert found is not None
    assert found.confidence < 0.5
    assert found.reason
    words, to_uncomment = sun_found(plate, np.eye(3))
    assert words.startswith("no sun; best candidate at azimuth")
    assert words.endswith(found.reason)
    lines = to_uncomment.strip().splitlines()
    assert all(line.startswith("# ") for line in lines)
    made = tomllib.loads("\n".join(line.removeprefix("# ") for line in lines[1:]))
    assert LightSettings(**made["light"]).sun == "given"
    words, to_uncomment = sun_found(LinearPlate(disc(1.0, 512)[0]), np.eye(3))
    assert words.startswith("sun at azimuth 123.7, elevation 65")
    assert to_uncomment == ""
    grey = LinearPlate(np.full((64, 128, 3), 0.2, np.float32))
    assert sun_found(grey, np.eye(3)) == ("no sun: nothing stands out", "")
