# SPDX-License-Identifier: Apache-2.0
"""Compiled rays against the same formulas of arrays."""

from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base import optics
from mr360uw.base.caustic_lookup import mip_level, mip_levels, periodic_trilinear
from mr360uw.base.sphere import unit
from mr360uw.base.texels import level_for, packed, periodic
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.medium import Medium, Water
from mr360uw.medium.lookup import transmittance_lookup, veil_lookup
from mr360uw.medium.models import FieldModel
from mr360uw.surface import intersection
from mr360uw.surface.facet_draws import drawn, facets_of, next_key, sunlight
from mr360uw.surface.ray_kernel import disc_of
from mr360uw.surface.sky import Dome, panorama, sky_radiance
from mr360uw.surface.water_light import WaterLight, WaterTable, transmittance, veil
from mr360uw.types import Sun
from tests.surface import tolerances as tol

COUNT = 40


def test_fresnel_refraction_and_reflection(rng: np.random.Generator) -> None:
    normal, travel = unit(rng.standard_normal((COUNT, 3))), unit(rng.standard_normal((COUNT, 3)))
    travel *= -np.sign(np.sum(travel * normal, axis=-1, keepdims=True))
    for m in (1.34, 1.0 / 1.34):
        found = [intersection.reflectance(-float(d @ n), m)[0] for d, n in zip(travel, normal, strict=True)]
        np.testing.assert_allclose(found, optics.fresnel(-np.sum(travel * normal, axis=-1), m), atol=tol.FLOAT64)
        found = [intersection.bent(*d, *n, 1.0 / m) for d, n in zip(travel, normal, strict=True)]
        np.testing.assert_allclose(
            found, unit(optics.refract_clamped(travel, normal, 1.0 / m)), atol=10.0 * tol.FLOAT64
        )
    found = [intersection.mirrored(*d, *n) for d, n in zip(travel, normal, strict=True)]
    np.testing.assert_allclose(found, optics.reflect(travel, normal), atol=10.0 * tol.FLOAT64)


@pytest.mark.parametrize("from_below", [False, True])
def test_the_sun_in_facets_is_the_mean_of_those_that_point_it_at_the_ray(from_below: bool) -> None:
    count, side, n = 100_000, -1.0 if from_below else 1.0, 1.34
    sun = Sun(unit([0.3, 0.8, -0.52]), np.array([1.0, 2.0, 3.0]), 0.05, 1.0)
    disc, _ = disc_of(sun)
    mean, covariance = unit([0.03, 1.0, -0.02]), (0.01, 0.002, 0.006)
    travel = optics.refract_to_water(sun.direction, n) if from_below else sun.direction * [1.0, -1.0, 1.0]
    d = tuple(travel.tolist())
    f = facets_of(d, tuple(mean.tolist()), covariance, side)
    normal = side * np.array([drawn(f, next_key(k, 3)) for k in range(count)])
    ray, cosine = np.tile(travel, (count, 1)), -normal @ travel
    out = optics.refract_clamped(ray, normal, n) if from_below else optics.reflect(ray, normal)
    sent = (1.0 - optics.fresnel_from_below(cosine, n)) * n * n if from_below else optics.fresnel(cosine, n)
    hits = unit(out) @ sun.direction >= np.cos(sun.half_angle_rad)
    assert hits.sum() > 1000
    found = sunlight(disc, d, tuple(mean.tolist()), f, side, n)
    assert found == pytest.approx(np.where(hits, sent, 0.0).mean(), rel=tol.SUN_BY_CHANCE)


def test_the_dome_and_maps_that_repeat(rng: np.random.Generator) -> None:
    dome = Dome(rng.uniform(0.0, 1.0, (16, 32, 3)))
    direction, footprint = unit(rng.standard_normal((COUNT, 3))), rng.uniform(0.0, 1.0, COUNT)
    texels, table = packed([level[None] for level in dome.levels])
    found = [sky_radiance(texels, table, *d, f) for d, f in zip(direction, footprint, strict=True)]
    np.testing.assert_allclose(found, dome.look(direction, footprint), atol=tol.SINGLE)

    levels = mip_levels(rng.uniform(0.0, 1.0, (1, 8, 8, 3)))
    texels, table = packed(levels)
    u, v, width = rng.uniform(-3.0, 3.0, (3, COUNT))
    level = mip_level(np.abs(width), 0.25, 3.0)
    found = [
        periodic(texels, table, 0, 4, u[k], v[k], level_for(abs(width[k]), 0.25, 3)) for k in range(COUNT)
    ]  # fmt: skip
    expected = periodic_trilinear(levels, np.zeros(COUNT, np.int64), u, v, level)
    np.testing.assert_allclose(found, expected, atol=tol.SINGLE)


def test_maps_about_the_sun(rng: np.random.Generator) -> None:
    texels, map_, v = rng.uniform(size=(5, 3)), rng.uniform(size=(8, 16, 3)), unit(rng.standard_normal((COUNT, 3)))
    packed_ = np.concatenate([texels, map_.reshape(-1, 3)]).astype(np.float32)
    found = [panorama(packed_, 5, 16, 8, tuple(one)) for one in v.tolist()]
    np.testing.assert_allclose(found, environment_lookup(map_, v), atol=tol.SINGLE)


def test_the_veil_of_sky_and_sun_is_the_solved_one_about_the_sun() -> None:
    depth, sun = 3.0, Sun(unit((0.5, 0.7, -0.2)), np.array([3.0, 2.5, 2.0]), 0.005, 1.0)
    water = WaterLight.of(Water.jerlov("IB"), Dome(np.full((4, 8, 3), 0.2)), sun, 1.34, 9.0, np.zeros(3))
    water = water.seen_from(depth)
    assert water.sky is not None
    assert water.sun is not None
    towards = optics.refract_to_water(sun.direction, 1.34)
    for v in unit([(1.0, 0.0, -0.4), (-1.0, -0.2, 0.1), (0.1, -0.8, 1.0)]):
        angle = np.arctan2(v[0] * towards[2] - v[2] * towards[0], v[0] * towards[0] + v[2] * towards[2])
        lobes = water.sun.medium.bands.lobes
        expected = 0.0
        for light in (water.sky, water.sun):
            model = light.medium.model
            seen = FieldModel(model.field.at_azimuth(float(angle)), model.part)
            expected = expected + light.below * (seen.inscatter(1e5, depth, v[1]) @ lobes)
        mean = water.along(np.array([np.inf]), v[1:2], True)[1][0]
        np.testing.assert_allclose(mean * environment_lookup(water.sun_maps[1], v), expected, rtol=tol.AROUND_SUN)


def test_the_water(rng: np.random.Generator) -> None:
    table = Medium(Water.jerlov("IB"), camera_depth_m=3.0, band_count=8).unit_table
    where = WaterTable(0, table.length_m, table.camera_depth_m)
    veils, attenuations = table.veil[None], table.attenuation[None]
    distance, up = rng.uniform(0.0, 60.0, COUNT), rng.uniform(-1.0, 1.0, COUNT)
    distance[0], up[0] = np.inf, -0.3
    found = [veil(veils, where, *pair) for pair in zip(distance, up, strict=True)]
    np.testing.assert_allclose(found, veil_lookup(table, distance, up), atol=tol.SINGLE)
    found = [transmittance(attenuations, where, *pair) for pair in zip(distance[1:], up[1:], strict=True)]
    np.testing.assert_allclose(found, transmittance_lookup(table, distance[1:], up[1:]), atol=tol.SINGLE)
