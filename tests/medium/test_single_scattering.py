# SPDX-License-Identifier: Apache-2.0
"""Light scattered once, against closed forms, adaptive quadrature, and its limits."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import quad

from mr360uw.base.sphere import unit
from mr360uw.errors import ParameterError
from mr360uw.medium import single_scattering
from mr360uw.medium.phase import phase_function
from mr360uw.types import CausticStack, Lamp, Sun, View
from tests.medium import tolerances as tol

PHASE = ("hg", 0.6)


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball with exact ray tests."""

    centre: np.ndarray
    radius: float

    @property
    def bounding_sphere(self):
        return self.centre, self.radius

    def distance(self, origins, directions):
        to = self.centre - origins
        along = np.sum(to * directions, axis=-1)
        half = self.radius**2 - np.sum(to * to, axis=-1) + along**2
        root = np.sqrt(np.maximum(half, 0.0))
        near = np.where(along > root, along - root, along + root)
        return np.where((half > 0.0) & (near > 0.0), near, np.inf)

    def occluded(self, origins, directions, reach_m=np.inf):
        return self.distance(origins, directions) < reach_m


BALL = Ball(np.array([0.3, 1.2, -2.5]), 0.5)


def sun(*direction: float, irradiance=1.0, half_angle=0.0) -> Sun:
    return Sun(unit(direction), np.asarray(irradiance, np.float64), half_angle, 1.0)


def beam_integral(view: View, light: Sun, a: float, b: float, v: np.ndarray, end: float, body: Ball | None) -> float:
    """Adaptive quadrature over the lit parts of a ray; parts end where the ray crosses the ball's shadow."""
    c, up, p = a + b, light.direction[1], phase_function(PHASE, np.arccos(v @ light.direction))
    edges = [0.0, end]
    if body is not None:  # the shadow is a cylinder about the line through the centre along the beam
        flat = v - (v @ light.direction) * light.direction
        to = body.centre - view.position
        to = to - (to @ light.direction) * light.direction
        qa, qb, qc = flat @ flat, -2.0 * flat @ to, to @ to - body.radius**2
        if (root := qb * qb - 4.0 * qa * qc) > 0.0:
            edges += [(-qb - np.sqrt(root)) / (2.0 * qa), (-qb + np.sqrt(root)) / (2.0 * qa)]
    edges = sorted(x for x in edges if 0.0 <= x <= end)
    total = 0.0
    for first, last in itertools.pairwise(edges):
        middle = (view.position + 0.5 * (first + last) * v)[None]
        if body is None or not body.occluded(middle, light.direction[None])[0]:
            total += quad(lambda s: np.exp(-c * s + c * s * v[1] / up), first, last, epsabs=0.0, epsrel=1e-9)[0]
    return b * p * total


@pytest.mark.parametrize("light", [sun(0.3, 0.9, -0.2), sun(-0.7, 0.72, 0.1)])
def test_without_bodies_it_is_the_closed_form(light: Sun) -> None:
    """The ray straight at the sun has eps = 0."""
    view = View(8, 4, position=np.array([0.0, 1.0, 0.0]), surface_y_m=6.0)
    found = single_scattering(view, 0.07, 0.12, PHASE, light)
    directions = view.directions(*_pixels(view))
    for j, i in np.ndindex(4, 8):
        v = directions[j, i]
        end = 5.0 / v[1] if v[1] > 0.0 else 300.0
        assert found[j, i] == pytest.approx(beam_integral(view, light, 0.07, 0.12, v, end, None), rel=tol.QUADRATURE)
    towards = View(2, 1, world_from_camera=_turned_to(light.direction), surface_y_m=5.0)
    straight = single_scattering(towards, 0.07, 0.12, PHASE, light, end_m=2.0)[0, 0]
    v = towards.directions(0.5, 0.5)
    assert straight == pytest.approx(beam_integral(towards, light, 0.07, 0.12, v, 2.0, None), rel=tol.QUADRATURE)


def _turned_to(direction: np.ndarray) -> np.ndarray:
    """Return a rotation whose pixel (0.5, 0.5) of a 2 x 1 frame, which looks along -x, looks along a direction."""
    side = unit(np.cross(direction, [0.3, 0.1, 0.9]))
    return np.stack([-direction, side, np.cross(-direction, side)], axis=-1)


def test_the_shadow_of_a_ball_is_that_of_quadrature() -> None:
    """What the ball takes, over the pixels where it takes a fiftieth of the light or more."""
    light, view = sun(0.3, 0.9, -0.2), View(64, 32, surface_y_m=5.0)
    found = single_scattering(view, 0.07, 0.12, PHASE, light, [BALL])
    directions = view.directions(*_pixels(view))
    hit = BALL.distance(np.zeros((2048, 3)), directions.reshape(-1, 3)).reshape(32, 64)
    open_water = single_scattering(view, 0.07, 0.12, PHASE, light, end_m=hit)
    taken = open_water - found
    shaded = np.argwhere(taken > 0.02 * open_water)
    assert len(shaded) > 20
    exact = []
    for j, i in shaded:
        v = directions[j, i]
        end = min(5.0 / v[1] if v[1] > 0.0 else 300.0, hit[j, i])
        exact.append(open_water[j, i] - beam_integral(view, light, 0.07, 0.12, v, end, BALL))
    error = taken[tuple(shaded.T)] - exact
    assert np.sqrt(np.mean(error**2)) < tol.SHAFT * np.sqrt(np.mean(np.square(exact)))
    small = View(16, 8, surface_y_m=5.0)
    coarse, fine = (single_scattering(small, 0.07, 0.12, PHASE, light, [BALL], steps=n) for n in (16, 1024))
    refined = single_scattering(small, 0.07, 0.12, PHASE, light, [BALL], steps=16, tolerance=2e-4)
    assert np.abs(refined - fine).max() < 0.5 * np.abs(coarse - fine).max()


def _pixels(view: View):
    return np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)


def test_the_cone_of_a_spot_lamp_is_that_of_quadrature() -> None:
    view = View(32, 16, surface_y_m=5.0)
    lamp = Lamp(
        np.array([1.5, -0.5, -1.0]), unit([-1.0, 0.2, -0.4]), np.full(3, 2.0), cos_core=0.95, cos_edge=0.85,
        radius_m=0.02,
    )  # fmt: skip
    found = single_scattering(view, 0.07, 0.12, PHASE, None, lamps=[lamp])
    shaded = single_scattering(view, 0.07, 0.12, PHASE, None, [Ball(np.array([0.2, -0.25, -1.5]), 0.3)], lamps=[lamp])
    assert np.all(shaded <= found * (1.0 + tol.SHAFT))
    assert shaded.min() < 0.5 * found.max()
    for j, i in np.argwhere(found > 0.1 * np.median(found[found > 0.0]))[::40]:
        v = view.directions(i + 0.5, j + 0.5)

        def light(s: float, v=v) -> float:
            away = lamp.position - s * v
            r = max(float(np.linalg.norm(away)), lamp.radius_m)
            t = np.clip((-(away / r) @ lamp.axis - 0.85) / 0.1, 0.0, 1.0)
            p = float(phase_function(PHASE, np.arccos(np.clip(away @ v / r, -1.0, 1.0))))
            return 2.0 * t * t * (3.0 - 2.0 * t) / r**2 * 0.12 * p * np.exp(-0.19 * (r + s))

        end = 5.0 / v[1] if v[1] > 0.0 else 40.0
        grid = np.linspace(0.0, min(end, 40.0), 16)
        exact = sum(quad(light, p, q, limit=100)[0] for p, q in itertools.pairwise(grid))
        assert found[j, i] == pytest.approx(exact, rel=tol.SHAFT, abs=tol.SHAFT * 0.01 * found.max())


def test_shapes_follow_the_coefficients() -> None:
    light, view = sun(0.3, 0.9, -0.2, irradiance=np.ones(3)), View(8, 4)
    one = single_scattering(view, 0.07, 0.12, PHASE, light)
    assert one.shape == (4, 8)
    three = single_scattering(view, np.array([0.07, 0.1, 0.3]), 0.12, PHASE, light)
    assert three.shape == (4, 8, 3)
    np.testing.assert_allclose(three[..., 0], one, rtol=tol.FLOAT64)
    assert single_scattering(view, np.full(5, 0.1), 0.1, PHASE, light).shape == (4, 8, 5)
    coloured = single_scattering(view, np.full(3, 0.07), 0.12, PHASE, sun(0.3, 0.9, -0.2, irradiance=[1.0, 2.0, 3.0]))
    np.testing.assert_allclose(coloured, one[..., None] * [1.0, 2.0, 3.0], rtol=tol.FLOAT64)
    moved = View(8, 4, position=np.array([0.0, 2.0, 0.0]), surface_y_m=9.0)
    np.testing.assert_array_equal(
        single_scattering(moved, 0.07, 0.12, PHASE, light, surface_y_m=7.0),
        single_scattering(View(8, 4, surface_y_m=5.0), 0.07, 0.12, PHASE, light),
    )


def test_triangles_meshes_and_ray_tests_are_bodies() -> None:
    light, view = sun(0.3, 0.9, -0.2), View(16, 8)
    triangles = np.array([[[-1.0, 1.0, -3.0], [2.0, 1.2, -3.0], [0.0, 1.1, -1.0]]])

    class Mesh:
        def __init__(self) -> None:
            self.triangles = triangles

    both = [single_scattering(view, 0.07, 0.12, PHASE, light, [body]) for body in (triangles, Mesh())]
    np.testing.assert_array_equal(*both)
    assert np.any(both[0] < single_scattering(view, 0.07, 0.12, PHASE, light))


def test_a_ray_in_full_shadow_is_dark() -> None:
    """The segments sum to the closed form: nothing is left to rounding, also inside a body around the camera."""
    around = Ball(np.zeros(3), 2.0)
    view, light = View(16, 8, surface_y_m=5.0), sun(0.3, 0.9, -0.2)
    lit = single_scattering(view, 0.07, 0.12, PHASE, light, end_m=2.0)
    np.testing.assert_allclose(single_scattering(view, 0.07, 0.12, PHASE, light, [around]) / lit, 0.0, atol=tol.SUMMED)


def test_caustics_factor_the_beam() -> None:
    """A stack that is twice as bright everywhere doubles the light but for the metre above its first plane."""
    light, view = sun(0.3, 0.9, -0.2), View(16, 8, surface_y_m=5.0)
    stack = CausticStack(np.full((2, 8, 8, 3), 2.0), np.array([1e-3, 9.0]), 4.0, light.direction)
    plain = single_scattering(view, 0.07, 0.12, PHASE, light)
    np.testing.assert_allclose(
        single_scattering(view, 0.07, 0.12, PHASE, light, caustics=stack), 2.0 * plain, rtol=tol.SHAFT
    )


STRESS = {
    "camera at the surface": {"view": View(16, 8, surface_y_m=0.0)},
    "sun at the edge of Snell's window": {"sun": sun(0.7459, 0.6661, 0.0)},
    "sun on the horizon": {"sun": sun(1.0, 1e-9, 0.0)},
    "no scattering": {"scattering": 0.0},
    "no absorption": {"absorption": 0.0},
    "no water": {"absorption": 0.0, "scattering": 0.0},
    "harbour": {"absorption": 1.5, "scattering": 4.0},
    "deep harbour": {"absorption": 1.5, "scattering": 4.0, "view": View(16, 8, surface_y_m=500.0)},
    "no distance": {"end_m": 0.0},
    "500 m": {"end_m": 500.0, "view": View(16, 8, surface_y_m=500.0)},
    "body around the camera": {"bodies": [Ball(np.zeros(3), 1.0)]},
    "lamp in a body": {"bodies": [Ball(np.array([1.0, 0.0, -1.0]), 0.5)]},
    "lamp in the camera": {"lamps": [Lamp(np.zeros(3), np.array([0.0, 0.0, -1.0]), np.ones(3))]},
    "sun under the horizon": {"sun": sun(0.5, -0.5, 0.0)},
}


@pytest.mark.parametrize("name", STRESS)
def test_stress(name: str) -> None:
    given = {
        "view": View(16, 8, surface_y_m=5.0), "absorption": 0.07, "scattering": 0.12, "phase": PHASE,
        "sun": sun(0.3, 0.9, -0.2), "bodies": [BALL],
        "lamps": [Lamp(np.array([1.0, 0.0, -1.0]), np.array([0.0, 0.0, -1.0]), np.ones(3))], **STRESS[name],
    }  # fmt: skip
    found = single_scattering(steps=64, **given)
    assert np.all(np.isfinite(found))
    open_water = single_scattering(steps=64, **{**given, "bodies": []})
    assert found.min() >= -tol.SUMMED * open_water.max()
    assert np.all(found <= open_water * (1.0 + tol.SHAFT) + tol.FLOAT64)
    if name in ("no scattering", "no water", "no distance"):
        assert not np.any(found)
    elif name == "lamp in a body":  # nothing of its light gets out
        without = single_scattering(steps=64, **{**given, "lamps": []})
        outside = single_scattering(steps=64, **{**given, "sun": None})
        assert outside.max() <= tol.SHAFT * open_water.max()
        assert np.abs(found - without).max() <= tol.SHAFT * open_water.max()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"absorption": -1.0}, "absorption"),
        ({"absorption": np.ones((2, 2))}, "absorption"),
        ({"scattering": np.nan}, "finite"),
        ({"phase": "milk"}, "phase"),
        ({"bodies": ["ball"]}, "bodies"),
        ({"bodies": [np.zeros((4, 3))]}, "T, 3, 3"),
        ({"caustics": np.ones((4, 4))}, "caustics"),
        ({"end_m": -1.0}, "end_m"),
        ({"end_m": np.ones((3, 3))}, "end_m"),
        ({"steps": 0}, "steps"),
        ({"surface_y_m": -2.0}, "above the water"),
        ({"sun": sun(0.3, 0.9, -0.2, irradiance=[1.0, 2.0, 3.0])}, "sun.irradiance"),
    ],
)
def test_wrong_arguments_are_refused(wrong: dict, message: str) -> None:
    given = {"absorption": 0.07, "scattering": 0.12, "phase": PHASE, "sun": sun(0.3, 0.9, -0.2), **wrong}
    with pytest.raises(ParameterError, match=message):
        single_scattering(View(8, 4), **given)
