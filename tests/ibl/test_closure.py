# SPDX-License-Identifier: Apache-2.0
"""The light of clipped suns: as the plate's sky and ground tell, and none where nothing was lost."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import mr360uw.ibl as ibl
from mr360uw.base.color import luminance
from mr360uw.base.sphere import direction_from_angles, directions, row_solid_angle
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.ibl.plate import LinearPlate
from mr360uw.ibl.settings import LightSettings
from mr360uw.ibl.sun.detect import find_disc
from mr360uw.ibl.sun.split import clear_ratio, shown_ratio, sky_irradiance, sunlight
from mr360uw.ibl.sun.spots import Blob, PlateSurvey, taken_share
from mr360uw.medium import Sensor
from tests.ibl.plates import clipped
from tests.ibl.tolerances import ENERGY_FLOAT32, FLOAT32_TWIN, RATIO_EXPOSURE, RATIO_OF_DISC, SUN_COLOR

PLACE = direction_from_angles(0.6, 0.9)
GLOW = direction_from_angles(0.6, np.radians(6.0))


def day(glow: float, ground: float, *, exposure: float = 0.03, columns: int = 1024) -> np.ndarray:
    """Return a clipped sky of radiance 1 with a sun and a glow that falls with the angle, over ground."""
    d = directions(columns, columns // 2)
    away = np.degrees(np.arccos(np.clip(d @ PLACE, -1.0, 1.0)))
    sky = 1.0 + 4.0 * glow / np.maximum(away, 1.0) + 4e4 * (away < 0.27)
    scene = np.where(d[..., 1] > 0.0, sky, ground)[..., None] * np.array([0.95, 1.0, 1.05])
    return clipped(scene.astype(np.float32), exposure)


def ratio_of(plate: np.ndarray) -> float:
    seen = LinearPlate(plate)
    return shown_ratio(seen, PLACE, sky_irradiance(seen.coarse), None)


def test_the_ratio_grows_with_glow_and_sunlit_ground() -> None:
    # the ground keeps its part of the light of the sky, which grows with the glow
    by_glow = [ratio_of(day(glow, 0.5 + 0.2 * glow)) for glow in (2.0, 10.0, 20.0, 40.0)]
    by_ground = [ratio_of(day(20.0, ground)) for ground in (0.5, 1.0, 2.0, 4.0)]
    for ratios in (by_glow, by_ground):
        assert ratios == sorted(ratios)
        assert ratios[-1] > 5.0 * ratios[0]
    assert by_glow[0] < 0.3


def test_the_ratio_hardly_depends_on_the_exposure() -> None:
    """More clips, and what is left of the glow is followed inwards."""
    ratios = [ratio_of(day(20.0, 1.5, exposure=exposure)) for exposure in (0.02, 0.06, 0.2)]
    assert max(ratios) < RATIO_EXPOSURE * min(ratios)


def test_a_strong_sun_is_given_more_light_than_a_veiled_one() -> None:
    strong, veiled = (ibl.environment(day(glow, ground)).sun for glow, ground in ((30.0, 2.5), (5.0, 0.6)))
    assert strong is not None
    assert veiled is not None
    assert luminance(strong.irradiance) > 4.0 * luminance(veiled.irradiance)


@pytest.mark.parametrize("ratio", [1.5, 3.0, 5.0])
def test_a_sun_whose_disc_alone_is_clipped_shines_through_clear_air(ratio: float) -> None:
    """Ground of albedo 0.3 under an even sky and a sun of a ratio of direct to diffuse light, without any glow."""
    light = ibl.environment(day(0.0, 0.3 * (1.0 + ratio), exposure=0.3, columns=2048))
    assert light.sun is not None
    sky = luminance(environment_lookup(light.ambient, [0.0, 1.0, 0.0]))
    found = luminance(light.sun.irradiance) * PLACE[1] / sky
    assert found == pytest.approx(np.sqrt(ratio * clear_ratio(PLACE[1])), rel=RATIO_OF_DISC)


def test_the_ratio_of_clear_air_rises_with_the_sun() -> None:
    ratios = [clear_ratio(np.sin(np.radians(e))) for e in (3.0, 10.0, 25.0, 45.0, 90.0)]
    assert ratios == sorted(ratios)
    assert ratios[3] == pytest.approx(3.0)


def test_where_nothing_was_lost_nothing_is_added() -> None:
    """A spot that just reaches white without a flat top is measured, as by no operator at all."""
    d = directions(1024, 512)
    away = np.degrees(np.arccos(np.clip(d @ PLACE, -1.0, 1.0)))
    scene = np.where(d[..., 1] > 0.0, 0.1, 0.05) + 0.87 * np.exp(-0.5 * (away / 1.5) ** 2)
    plate = clipped(np.repeat(scene[..., None], 3, axis=2).astype(np.float32))
    assert plate.max() < 1.0
    closed, plain = (ibl.environment(plate, LightSettings(operator=name)) for name in ("closure", "none"))
    assert closed.sun is not None
    np.testing.assert_array_equal(closed.irradiance, plain.irradiance)


def test_the_colour_of_sunlight_by_its_elevation() -> None:
    np.testing.assert_allclose(sunlight(np.sin(np.radians(45.0))), 1.0, atol=FLOAT32_TWIN)
    colours = [sunlight(np.sin(np.radians(e))) for e in (90.0, 45.0, 20.0, 8.0, 3.0)]
    for higher, lower in itertools.pairwise(colours):
        assert lower[0] / lower[2] > higher[0] / higher[2]
        assert luminance(lower) == pytest.approx(1.0, abs=FLOAT32_TWIN)


@pytest.mark.parametrize("elevation_deg", [5.0, 8.0, 20.0, 60.0, 90.0])
def test_the_colour_of_sunlight_is_that_of_its_spectrum(elevation_deg: float) -> None:
    """A black body of 5778 K through molecules and haze, integrated over the CIE 1931 observer, white at 45 degrees."""
    nm = np.arange(390.0, 731.0, 5.0)
    um = nm / 1000.0
    sun = nm**-5.0 / np.expm1(1.4387769e7 / (nm * 5778.0))
    depth = 0.008569 * um**-4 * (1.0 + 0.0113 * um**-2 + 0.00013 * um**-4) + 0.05 * um**-1.3
    degrees = np.array([elevation_deg, 45.0])
    air_mass = 1.0 / (np.sin(np.radians(degrees)) + 0.50572 * (degrees + 6.07995) ** -1.6364)
    seen, white = (sun * np.exp(-depth * air_mass[:, None])) @ Sensor.cie1931().response(nm)
    colour = seen / white / luminance(seen / white)
    np.testing.assert_allclose(sunlight(np.sin(np.radians(elevation_deg))), colour, atol=SUN_COLOR)


def test_a_sun_somewhere_in_a_clipped_sky_needs_the_ground_to_tell() -> None:
    """The glow clips over a twentieth of the sphere; sunlit ground says that a sun is in it, shaded ground does not."""
    sunlit, shaded = (find_disc(LinearPlate(day(40.0, ground, exposure=0.13))) for ground in (3.0, 1.0))
    assert sunlit is not None
    assert shaded is not None
    assert sunlit.confidence >= 0.5 > shaded.confidence
    assert np.degrees(np.arccos(sunlit.direction @ PLACE)) < 10.0


def test_ground_that_no_sun_makes_so_bright_speaks_for_none() -> None:
    """It is lit by lamps, or white; up to the ratio of the clearest air it speaks for a sun."""
    plate = LinearPlate(day(1.0, 1.0, columns=256))
    lit = [PlateSurvey(plate, plate.brightest, 1.0, 0.0, False, True, ratio).lit for ratio in (0.1, 1.0, 4.5, 12.0)]
    assert lit == [0.0, 1.0, 1.0, 0.0]


def test_a_sun_in_doubt_gives_a_share_of_its_light() -> None:
    """From none to all with the sun's confidence, smoothly; what is not the beam's stays in the sky."""
    shares = [taken_share(confidence) for confidence in np.linspace(0.0, 1.0, 101)]
    assert (shares[0], shares[50], shares[-1]) == (0.0, 0.5, 1.0)
    assert 0.0 <= np.diff(shares).min() <= np.diff(shares).max() < 0.05  # of its steps a hundredth wide
    plate = day(40.0, 3.0, exposure=0.13)
    total = ibl.environment(plate, expansion="none", sun=None).residual
    area = row_solid_angle(64, 32)[:, None, None]
    light = ibl.environment(plate, LightSettings(operator="none"))
    assert light.sun is not None
    whole = (light.residual * area).sum(axis=(0, 1)) + light.sun.irradiance
    np.testing.assert_allclose(whole, (total * area).sum(axis=(0, 1)), rtol=ENERGY_FLOAT32)


def dusk(gap: np.ndarray, ground: float) -> Blob:
    """Return a gap of white sky between the clouds of a dusk, taken for the sun; the sky glows 6 degrees high."""
    d = directions(512, 256)
    away = np.degrees(np.arccos(np.clip(d @ GLOW, -1.0, 1.0)))
    sky = 0.2 + 0.7 * np.exp(-away / 20.0) + 1.0 * (d @ gap > np.cos(np.radians(3.0)))
    scene = np.where(d[..., 1] > 0.0, sky, ground)[..., None] * np.array([0.95, 1.0, 1.05])
    found = find_disc(LinearPlate(clipped(scene.astype(np.float32))))
    assert found is not None
    return found


def test_a_gap_in_the_clouds_of_a_dusk_is_no_sun() -> None:
    """Where the glow points elsewhere and the ground is dark; either alone leaves the spot as it is."""
    beside = direction_from_angles(1.0, np.radians(18.0))
    gap = dusk(beside, 0.05)
    assert gap.confidence < 0.5
    assert dusk(beside, 0.9).confidence > 0.9
    assert dusk(GLOW, 0.05).confidence > 0.9
