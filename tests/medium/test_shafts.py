# SPDX-License-Identifier: Apache-2.0
"""Deviation of the light in the water: against single scattering, its limits, and the grid against rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mr360uw.base.sphere import direction_from_angles, unit
from mr360uw.caustics import CausticSettings, GerstnerSea, caustic_stack, refract_to_air, stack_depths
from mr360uw.errors import ParameterError
from mr360uw.medium import FroxelGrid, Medium, ShaftScene, Water, shaft_deviation, shaft_field, single_scattering
from mr360uw.medium.phase import phase_moments, wide_angle_function, wide_angle_moments
from mr360uw.medium.shafts.shaft_field import march
from mr360uw.medium.shafts.single_scattering import fraction_at, radius_at
from mr360uw.types import CausticStack, Lamp, Sun, View
from tests.medium import tolerances as tol
from tests.medium.test_single_scattering import BALL, Ball, sun

VIEW = View(32, 16, surface_y_m=5.0)
SUN = sun(0.3, 0.9, -0.2, irradiance=[1.0, 2.0, 3.0])
LAMP = Lamp(np.array([1.0, -0.3, -1.0]), unit([-1.0, 0.3, -0.5]), np.array([1.0, 2.0, 0.5]), 0.9, 0.8, 0.02)
SMALL = FroxelGrid(48, 96, 24)


def medium(name: str = "IB", mode: str = "table") -> Medium:
    return Medium(Water.jerlov(name), mode=mode, camera_depth_m=5.0, band_count=4, rule="fitted")


def flat(value: float = 1.0, soft: float = 1.0) -> CausticStack:
    maps = np.full((2, 8, 8, 3), value), np.full((2, 8, 8, 1), soft)
    return CausticStack(maps[0], np.array([1e-6, 9.0]), 4.0, SUN.direction, maps[1])


@pytest.mark.parametrize("grid", [None, SMALL])
def test_nothing_deviates_under_an_open_flat_sea(grid: FroxelGrid | None) -> None:
    assert not np.any(shaft_deviation(VIEW, medium(), SUN, grid=grid))
    assert not np.any(shaft_deviation(VIEW, medium(), None, [BALL], flat(3.0), grid=grid))
    even = shaft_deviation(VIEW, medium(), SUN, (), flat(), grid=grid)
    np.testing.assert_allclose(even, 0.0, atol=tol.SUMMED)


@pytest.mark.parametrize("bodies", [[BALL], [BALL, Ball(np.array([-1.0, 0.0, -1.0]), 0.4)]])
def test_at_three_wavelengths_it_is_single_scattering(bodies: list[Ball]) -> None:
    """Mode rgb: isotropic, c' = c, one wavelength a channel. What bodies take, and the light of a lamp."""
    water = medium(mode="rgb")
    nm, still = water.bands.wavelength_nm, replace(SUN, half_angle_rad=0.0)
    a, b = water.water.absorption(nm), water.water.scattering(nm)
    given = {"steps": 256, "lamps": [LAMP]}
    ends = np.minimum(*(body.distance(np.zeros((512, 3)), _directions()) for body in (bodies[0], bodies[-1])))
    lit = single_scattering(VIEW, a, b, "isotropic", still, end_m=ends.reshape(16, 32))
    once = single_scattering(VIEW, a, b, "isotropic", still, bodies, **given)
    found = shaft_deviation(VIEW, water, still, bodies, grid=None, spread_rad=0.0, **given)
    error = np.sqrt(np.mean((found - (once - lit)) ** 2))
    assert error < tol.SHAFT * np.sqrt(np.mean(found**2))


def _directions() -> np.ndarray:
    return VIEW.directions(*np.meshgrid(np.arange(32) + 0.5, np.arange(16) + 0.5)).reshape(-1, 3)


@pytest.mark.parametrize("name", ["IA", "3C"])
def test_in_full_shadow_the_beam_is_missing(name: str) -> None:
    """Minus the closed form of the beam's wide-angle scattering, summed over the wavelengths one by one."""
    water, reach = medium(name), 2.0
    found = shaft_deviation(VIEW, water, SUN, [Ball(np.zeros(3), reach)], grid=None, steps=16)
    nm, model, up = water.bands.wavelength_nm, water.model, SUN.direction[1]
    path = 5.0 / up
    light = water.bands.lobes * np.exp(-model.extinction * path)[:, None]
    light = SUN.irradiance * light / light.sum(axis=0)
    theta = np.arccos(_directions() @ SUN.direction)
    molecules = water.water.molecular(nm)
    particles = water.water.scattering(nm) - molecules
    source = molecules * _p("water", theta) + particles * _p("petzold", theta)
    rate = model.extinction * (1.0 - _directions()[:, 1:2] / up)
    expected = -(source * -np.expm1(-rate * reach) / rate) @ light
    np.testing.assert_allclose(found.reshape(-1, 3), expected, rtol=1e3 * tol.SUMMED)


def _p(phase: str, theta: np.ndarray) -> np.ndarray:
    return wide_angle_function(phase, theta)[:, None]


def test_the_cut_phase_function_has_the_moments_of_the_field() -> None:
    theta = np.concatenate([np.geomspace(1e-8, 0.1, 2000), np.linspace(0.1, np.pi, 2000)[1:]])
    weight = np.gradient(theta)
    for phase in ("petzold", ("hg", 0.9), "isotropic"):
        p = wide_angle_function(phase, theta) * np.sin(theta) * weight * 2.0 * np.pi
        assert p.sum() == pytest.approx(wide_angle_moments(phase, 1)[0], rel=tol.PHASE_NORM)
        assert p @ np.cos(theta) == pytest.approx(wide_angle_moments(phase, 2)[1], abs=tol.PHASE_NORM)
    assert phase_moments("petzold", 2)[1] > 0.9


def test_turned_light_carries_its_own_pattern() -> None:
    """With a blurred pattern of 1 only the unturned fraction of the beam deviates; with both of 2 all of it does."""
    view = View(16, 8, surface_y_m=5.0)
    both = shaft_deviation(view, medium(), SUN, (), flat(2.0, 2.0), grid=None, steps=64)
    sharp = shaft_deviation(view, medium(), SUN, (), flat(2.0), grid=None, steps=64)
    soft = shaft_deviation(view, medium(), SUN, (), flat(1.0, 2.0), grid=None, steps=64)
    np.testing.assert_allclose(sharp + soft, both, rtol=tol.FLOAT32)
    assert np.all(sharp > 0.0)
    assert np.all(soft > 0.0)
    assert np.all(both >= sharp)


def test_the_mean_over_the_waves_adds_nothing() -> None:
    """Mean over places of the camera in one period of the waves, in a thousandth of the beam's own light."""
    sea = GerstnerSea(wind_speed=4.0, tile_m=4.0, seed=2)
    light = Sun(direction_from_angles(0.5, np.radians(70.0)), np.ones(3), 0.0035, 1.0)
    stack = caustic_stack(
        sea, refract_to_air(light.direction), stack_depths(0.2, 12.0, 6), 0.0, CausticSettings(size=32, grid=64)
    )
    total, beam = np.zeros(3), np.zeros(3)
    for x in range(8):
        for z in range(8):
            view = View(16, 8, position=np.array([0.5 * x, 0.0, 0.5 * z]), surface_y_m=5.0)
            total += shaft_deviation(view, medium(), light, (), stack, grid=None, steps=24).sum(axis=(0, 1))
    beam = shaft_deviation(view, medium(), light, (), flat(2.0, 2.0), grid=None, steps=24).sum(axis=(0, 1))
    assert np.all(np.abs(total) <= tol.MEAN_OF_WAVES * 64 * beam)


def test_the_grid_is_the_march_of_rays() -> None:
    """A slow pattern, which the small grid resolves."""
    x = (np.arange(32) + 0.5) / 32
    ratio = 1.0 + 0.8 * np.sin(2.0 * np.pi * x)[:, None] * np.cos(2.0 * np.pi * x)
    stack = CausticStack(
        np.broadcast_to(ratio[None, :, :, None], (2, 32, 32, 3)).copy(), np.array([0.5, 20.0]), 12.0, SUN.direction
    )
    scene = ShaftScene.of(VIEW, medium(), [SUN], (), stack)
    directions = unit(np.random.default_rng(1).normal(size=(300, 3)))
    _, ends = scene.layout(directions[:, 1])
    ends = ends * np.linspace(0.05, 1.0, 300)
    truth = march(scene, directions, ends, 1024)
    field = shaft_field(scene, SMALL)
    error = np.sqrt(np.mean((field.radiance(directions, ends) - truth) ** 2) / np.mean(truth**2))
    assert error < tol.FROXELS
    few = shaft_field(scene, SMALL, directions[:7])
    np.testing.assert_array_equal(few.radiance(directions[:7], ends[:7]), field.radiance(directions[:7], ends[:7]))
    assert len(few.table) <= 7 * 16
    with pytest.raises(ParameterError, match="rays"):
        few.radiance(directions, ends)
    assert not np.any(field.radiance(directions, np.zeros(300)))


class Endless(Ball):
    """A ball that does not say how large it is: no map of it can be made."""

    bounding_sphere = np.zeros(3), np.inf


@pytest.mark.parametrize("kind", [Ball, Endless])
@pytest.mark.parametrize("lamps", [(), (LAMP,)])
def test_shadows_on_the_grid_are_those_of_rays(kind: type[Ball], lamps: tuple[Lamp, ...]) -> None:
    """Visibility by rays and by maps, of the sun and of a lamp."""
    body = kind(np.array([0.2, 1.0, -2.0]), 0.5)
    scene = ShaftScene.of(VIEW, medium(), lamps or [SUN], [body])
    towards = body.centre - 1.5 * SUN.direction
    directions = unit(towards + np.random.default_rng(2).normal(scale=0.6, size=(60, 3)))
    ends = np.minimum(body.distance(np.zeros((60, 3)), directions), 6.0)
    truth = march(scene, directions, ends, 1024)
    found = shaft_field(scene, FroxelGrid(384, 1024, 32), directions).radiance(directions, ends)
    assert np.sqrt(np.mean((found - truth) ** 2) / np.mean(truth**2)) < tol.FROXELS


def test_the_grid_has_no_seam_and_no_poles() -> None:
    scene = ShaftScene.of(VIEW, medium(), [SUN], [BALL, Ball(np.array([0.2, 3.0, 2.0]), 0.7)])
    field = shaft_field(scene, SMALL)
    latitude = np.linspace(-1.5, 1.5, 40)
    ends = np.full(40, 20.0)

    def around(lon: float) -> np.ndarray:
        ring = np.cos(latitude) * np.sin(lon), np.sin(latitude), -np.cos(latitude) * np.cos(lon)
        return field.radiance(np.stack(ring, axis=-1), ends)

    largest = np.abs(field.radiance(_directions(), np.full(512, 20.0))).max()
    np.testing.assert_allclose(around(np.pi - 1e-7), around(-np.pi + 1e-7), atol=tol.NEXT_TO * largest)
    turn = np.linspace(0.0, 2.0 * np.pi, 40)
    for up in (1.0, -1.0):
        ring = np.stack([1e-6 * np.sin(turn), np.full(40, up), 1e-6 * np.cos(turn)], axis=-1)
        pole = field.radiance(unit(ring), ends)
        np.testing.assert_allclose(pole, np.broadcast_to(pole[0], (40, 3)), atol=tol.NEXT_TO * largest)


@pytest.mark.parametrize(("rate", "reach"), [(0.3, 20.0), (-0.4, 9.0), (0.0, 7.0), (2.0, 1e9), (0.1, 0.0)])
def test_segments_share_the_light_evenly(rate: float, reach: float) -> None:
    t = np.linspace(0.0, 1.0, 9)
    r = radius_at(t, rate, reach)
    assert np.all(np.diff(r) >= 0.0)
    assert r[4] <= 3.0 / max(abs(rate), 1.0 / max(reach, 1e-9))
    if reach > 0.0:
        np.testing.assert_allclose(fraction_at(r, rate, reach)[:-1], t[:-1], atol=tol.QUADRATURE)


def test_a_lamp_of_its_own_colour_fades_as_its_table_says() -> None:
    water = medium()
    grey = replace(LAMP, attenuation=np.full((8, 3), 0.4))
    found, white = (shaft_deviation(VIEW, water, None, lamps=[lamp], grid=None, steps=64) for lamp in (grey, LAMP))
    assert np.all(found[white > 0.0] > 0.0)
    assert np.all(found.sum(axis=(0, 1)) != white.sum(axis=(0, 1)))


STRESS = {
    "camera at the surface": ({"view": View(16, 8, surface_y_m=0.0)}, "5C"),
    "sun at the edge of Snell's window": ({"sun": sun(0.7459, 0.6661, 0.0, irradiance=np.ones(3))}, "IB"),
    "harbour": ({}, "9C"),
    "500 m": ({"view": View(16, 8, surface_y_m=500.0), "end_m": 500.0}, "9C"),
    "no distance": ({"end_m": 0.0}, "IA"),
    "around the camera": ({"bodies": [Ball(np.zeros(3), 1.0)]}, "IB"),
    "lamp in a body": ({"bodies": [Ball(LAMP.position, 0.5)]}, "IB"),
}


@pytest.mark.parametrize("name", STRESS)
@pytest.mark.parametrize("grid", [None, FroxelGrid(8, 16, 8)])
def test_stress(name: str, grid: FroxelGrid | None) -> None:
    more, type_ = STRESS[name]
    given = {"view": View(16, 8, surface_y_m=5.0), "sun": SUN, "bodies": [BALL], **more}
    taken = shaft_deviation(medium=medium(type_), grid=grid, steps=64, **given)
    added = shaft_deviation(medium=medium(type_), grid=grid, steps=64, lamps=[LAMP], **{**given, "sun": None})
    assert np.all(np.isfinite(taken))
    assert np.all(np.isfinite(added))
    slack = 0.0 if grid is None else tol.OVERSHOOT
    assert taken.max() <= slack * np.abs(taken).max() + tol.SUMMED
    assert added.min() >= -slack * np.abs(added).max()
    if name in ("lamp in a body", "no distance"):
        assert not np.any(added)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"steps": 0, "grid": None}, "steps"),
        ({"sun": sun(0.3, 0.9, -0.2)}, "irradiance"),
        ({"sun_samples": 0}, "sun_samples"),
        ({"spread_rad": 2.0}, "spread_rad"),
        ({"view": View(4, 2, surface_y_m=-1.0)}, "above the water"),
    ],
)
def test_wrong_arguments_are_refused(wrong: dict, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        shaft_deviation(**{"view": VIEW, "medium": medium(), "sun": SUN, "bodies": [BALL], **wrong})
    with pytest.raises(ParameterError, match="even columns"):
        FroxelGrid(8, 9, 4)
