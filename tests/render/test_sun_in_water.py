# SPDX-License-Identifier: Apache-2.0
"""The sun of a plate under water: no water is the limit of thin water, and deep water dims and colours the beam."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from mr360uw.base.color import luminance
from mr360uw.base.sphere import direction_from_angles
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.render.surroundings import load_surroundings
from mr360uw.sample.dive import record
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.rendered_dive import Dive
from mr360uw.types import Environment, Floats
from mr360uw.video import open_video
from tests.ibl.plates import clipped, sky
from tests.ibl.tolerances import CLOSURE_RATIO
from tests.scenes import scene_with
from tests.tolerances import THIN_WATER

AZIMUTH_DEG, ELEVATION_DEG = 40.0, 65.0
PLACE = direction_from_angles(np.radians(AZIMUTH_DEG), np.radians(ELEVATION_DEG))
UP = np.array([0.0, 1.0, 0.0])
STEADY_BEAM = 1.5
"""Waves move the light about the sun by some tenths; a beam that is now and then a glint's falls to an eighth."""


def light_in(folder: Path, water: str, depth_m: float, ratio: float | None = None) -> Environment:
    """Return the light of a clipped sky seen by a camera at a depth of a water."""
    given = {"sun": "given", "sun_azimuth_deg": AZIMUTH_DEG, "sun_elevation_deg": ELEVATION_DEG}
    given |= {} if ratio is None else {"direct_to_diffuse": ratio}
    scene = scene_with(folder, None, water={"type": water}, camera={"depth_m": depth_m}, light=given)
    return load_surroundings(scene).light.of(clipped(sky(PLACE, width=256, half_angle_rad=0.04)))


def beam_of(light: Environment) -> Floats:
    assert light.sun is not None
    return light.sun.irradiance


@pytest.mark.parametrize(("water", "ratio"), [("IB", None), ("9C", 2.0)])
def test_no_water_is_the_limit_of_thin_water(tmp_path: Path, water: str, ratio: float | None) -> None:
    air = light_in(tmp_path, "none", 5.0, ratio)
    apart = []
    for depth_m in (0.03, 0.01):
        light = light_in(tmp_path, water, depth_m, ratio)
        changes = (beam_of(light) / beam_of(air), light.ambient / air.ambient)
        apart.append([float(np.abs(np.log(change)).max()) for change in changes])
    np.testing.assert_allclose(apart[1], np.array(apart[0]) / 3.0, rtol=THIN_WATER)


def test_deep_water_dims_the_beam_and_takes_its_red(tmp_path: Path) -> None:
    shallow, deep = (beam_of(light_in(tmp_path, "II", depth_m)) for depth_m in (2.0, 12.0))
    assert luminance(deep) < 0.7 * luminance(shallow)
    assert deep[0] / deep[1] < shallow[0] / shallow[1]


@pytest.mark.parametrize("depth_m", [0.3, 6.0])
def test_a_given_ratio_is_that_at_the_camera(tmp_path: Path, depth_m: float) -> None:
    light = light_in(tmp_path, "IB", depth_m, 1.5)
    assert light.sun is not None
    beam = luminance(beam_of(light)) * light.sun.direction[1]
    sky_light = luminance(environment_lookup(light.ambient, UP))
    assert beam / sky_light == pytest.approx(1.5, rel=CLOSURE_RATIO)


def test_a_glint_of_the_waves_is_not_taken_for_the_disc(tmp_path: Path) -> None:
    """In some frames the glitter is a sharp spot that does not clip, with a twentieth of the beam's light."""
    dive = DiveSettings(
        depth_m=5.9, floor_m=8.38, water="II", sky="even", sun_elevation_deg=48.7, sun_azimuth_deg=14.8,
        wind_m_s=2.49, wind_direction_deg=100.3, sand_albedo=0.175, relief=0.0, rocks=0.0, grass=0.0, seed=1121458970,
    )  # fmt: skip
    light = load_surroundings(
        scene_with(tmp_path, None, water={"type": dive.water}, camera={"depth_m": dive.depth_m})
    ).light
    plate = Dive(dive, 512, 256)
    record(tmp_path / "dive.mp4", [plate.radiance(k / 6.0) for k in range(4)], Fraction(6), dive.seed)
    with open_video(tmp_path / "dive.mp4") as video:
        beams = [luminance(beam_of(light.of(frame.pixels, time_s=frame.time_s))) for frame in video.frames()]
    assert max(beams) < STEADY_BEAM * min(beams)
