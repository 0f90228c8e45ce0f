# SPDX-License-Identifier: Apache-2.0
"""Dry scenes on a floor, described once: our `Shot` and another renderer's scene are made from the same numbers.

The camera is at the origin; an endless diffuse floor of albedo `FLOOR_ALBEDO` is at the height `FLOOR_Y_M`. A `Sky` is
a radiance over directions and, where it is clear, a sun whose disc is evenly bright. Diffuse bodies are Lambertian:
their refractive index is that of air, so nothing is reflected at their surface. The plate is the picture without the
bodies. It needs no sampling: the floor sees the sky alone, so its radiance is albedo E / pi everywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from mr360uw import ibl
from mr360uw.base.constants import SUN_HALF_ANGLE_RAD
from mr360uw.base.sphere import direction_from_angles, directions, frame_from_direction, row_solid_angle
from mr360uw.composite import PlacedObject, Receiver, Shot
from mr360uw.composite.mesh.material import Material, Part
from mr360uw.composite.mesh.mesh import Mesh, make_mesh
from mr360uw.ibl.lighting import assemble
from mr360uw.ibl.lookup import reduce_map
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS
from mr360uw.ibl.settings import GLOSSY_ROUGHNESS
from mr360uw.types import Environment, Floats, Sun, View
from tests.composite.scenes import placed, sphere

FLOOR_Y_M = -1.2
FLOOR_ALBEDO = np.array([0.42, 0.40, 0.37])
PAVING_CONTRAST = 0.5
WIDTH = 384
"""Columns of the pictures: a pixel is 0.94 degrees, a ball of 0.3 m at 2.5 m is 15 pixels wide."""
_SPHERE_ROWS = 40
"""Triangles are 4.5 degrees of a ball: the truth is of the same triangles and normals."""
_FINE = 8
"""Directions across a pixel of such a plate that its mean is taken over; fewer in a wider plate."""
_DISC_POINTS = 4096


@dataclass(frozen=True, slots=True)
class Sky:
    """radiance: of directions (..., 3) above the horizon, without the sun, (..., 3). sun: its disc, or None."""

    name: str
    radiance: Callable[[Floats], Floats]
    sun: Sun | None = None

    @property
    def floor_radiance(self) -> Floats:
        """Radiance (3,) of the floor where nothing stands on it."""
        fine = directions(1024, 512)[:256]
        weight = fine[..., 1] * row_solid_angle(1024, 512)[:256, None]
        irradiance = np.tensordot(weight, self.radiance(fine), 2)
        if self.sun is not None:
            irradiance = irradiance + self.sun.irradiance * self.sun.direction[1]
        return FLOOR_ALBEDO / np.pi * irradiance

    def plate(self, width: int = WIDTH, *, sun: bool = True, paving_m: float = 0.0) -> Floats:
        """Return the plate (H, W, 3), means over its pixels, of unlimited range; on request without the sun's disc.

        paving_m: side of the floor's slabs, see `paving`.
        """
        fine = max(_FINE * WIDTH // width, 2)
        around = directions(fine * width, fine * width // 2)
        light = np.where(around[..., 1:2] > 0.0, self.radiance(around), self.floor_radiance)
        if paving_m > 0.0:
            below = around[len(around) // 2 :]
            point = FLOOR_Y_M * below / below[..., 1:2]
            light[len(around) // 2 :] *= paving(point[..., 0], point[..., 2], paving_m)[..., None]
        image = reduce_map(light.astype(np.float32), width, width // 2)
        if sun and self.sun is not None:
            image = image + disc(self.sun, width)
        return image.astype(np.float32)


def paving(x_m: Floats, z_m: Floats, side_m: float) -> Floats:
    """Return the albedo of a floor of dark and light slabs over its mean, at places of any shape; dark at x, z > 0."""
    dark = (np.floor(x_m / side_m) + np.floor(z_m / side_m)) % 2.0 == 0.0
    return np.where(dark, 1.0 - PAVING_CONTRAST, 1.0 + PAVING_CONTRAST)


def disc(sun: Sun, width: int) -> Floats:
    """Return the radiance (H, W, 3) of a sun's disc, means over the pixels; its energy is exact."""
    k = np.arange(_DISC_POINTS) + 0.5
    radius, angle = np.tan(sun.half_angle_rad) * np.sqrt(k / _DISC_POINTS), np.pi * (3.0 - np.sqrt(5.0)) * k
    side = np.cross(sun.direction, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    other = np.cross(sun.direction, side)
    points = sun.direction + (radius * np.cos(angle))[:, None] * side + (radius * np.sin(angle))[:, None] * other
    x, y = frame_from_direction(points, width, width // 2)
    count = np.zeros((width // 2, width))
    np.add.at(count, (y.astype(int), x.astype(int)), 1.0 / _DISC_POINTS)
    return (count / row_solid_angle(width, width // 2)[:, None])[..., None] * sun.irradiance


def _overcast(direction: Floats) -> Floats:
    """Moon & Spencer 1942: three times as bright at the zenith as at the horizon."""
    return np.array([0.90, 0.95, 1.0]) * (1.0 + 2.0 * np.maximum(direction[..., 1:2], 0.0)) / 3.0


_SUN = Sun(
    direction_from_angles(np.radians(-60.0), np.radians(45.0)), np.array([5.0, 4.6, 3.9]), SUN_HALF_ANGLE_RAD, 1.0
)


def _clear(direction: Floats) -> Floats:
    """Blue from zenith to horizon, and a wide glow about the sun."""
    height = np.sqrt(np.maximum(direction[..., 1:2], 0.0))
    glow = np.exp(-np.arccos(np.clip(direction @ _SUN.direction, -1.0, 1.0)) / np.radians(20.0))[..., None]
    return (
        (1.0 - height) * np.array([0.55, 0.65, 0.80])
        + height * np.array([0.18, 0.32, 0.65])
        + glow * np.array([0.80, 0.72, 0.60])
    )


SKIES = {sky.name: sky for sky in (Sky("overcast", _overcast), Sky("clear", _clear, _SUN))}


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Bodies on the floor. look_at: (3,) the middle of the part of the frame that is compared, fov_deg wide.

    inside: lowest and highest corner (2, 3) of a hollow whose surfaces are compared by themselves; None without.
    paving_m: side of the floor's slabs, dark and light in turns; 0: the floor is even.
    """

    name: str
    bodies: tuple[PlacedObject, ...]
    look_at: tuple[float, float, float] = (0.1, -1.0, -2.4)
    fov_deg: float = 70.0
    inside: Floats | None = None
    paving_m: float = 0.0

    def plate(self, sky: Sky, width: int = WIDTH, *, sun: bool = True) -> Floats:
        """Return the plate (H, W, 3) of the scene under a sky."""
        return sky.plate(width, sun=sun, paving_m=self.paving_m)

    def shot(self, light: Environment, width: int = WIDTH) -> Shot:
        """Return the shot of the scene in a light and, as a light of its own, the light's sun."""
        lights = () if light.sun is None else (light.sun,)
        view, receiver = View(width, width // 2), Receiver(plane_y=FLOOR_Y_M)
        return Shot(view, self.bodies, light, lights, receiver=receiver)


def lights(sky: Sky, paving_m: float = 0.0) -> dict[str, Environment]:
    """Return the light exactly as it is drawn ("known"), and as it is measured in the plate ("plate")."""
    roughness = GLOSSY_ROUGHNESS
    coarse = reduce_map(sky.plate(sun=False, paving_m=paving_m), COARSE_COLUMNS, COARSE_ROWS)
    return {
        "known": assemble(coarse, sky.sun, roughness),
        "plate": ibl.environment(sky.plate(paving_m=paving_m), expansion="none", glossy=True),
    }


# --- bodies --------------------------------------------------------------------------------------------------------


def diffuse(color: tuple[float, float, float], *, double_sided: bool = False) -> Material:
    """Return a Lambertian material."""
    return Material(base_color=(*color, 1.0), roughness=1.0, refractive_index=1.0, double_sided=double_sided)


def ball(radius: float, x: float, z: float, material: Material, gap: float = 0.0) -> PlacedObject:
    """Return a ball over the floor; gap [m] between them."""
    return placed(sphere(_SPHERE_ROWS, material, radius), (x, FLOOR_Y_M + radius + gap, z))


def torus(ring: float, tube: float, material: Material, around: int = 96, across: int = 48) -> Mesh:
    """Return a torus about the y axis; ring and tube are its radii [m]."""
    u, v = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b = 2.0 * np.pi * u / around, 2.0 * np.pi * v / across
    normal = np.stack([np.cos(b) * np.cos(a), np.sin(b), np.cos(b) * np.sin(a)], axis=-1)
    center = ring * np.stack([np.cos(a), np.zeros_like(a), np.sin(a)], axis=-1)
    corners = [(u + i) % around * across + (v + j) % across for i, j in ((0, 0), (0, 1), (1, 1), (1, 0))]
    p, q, r, s = (c.ravel() for c in corners)
    faces = np.concatenate([np.stack([p, q, r], -1), np.stack([p, r, s], -1)])
    part = Part("torus", (center + tube * normal).reshape(-1, 3), faces, normal.reshape(-1, 3))
    return make_mesh([part], [material])


def crate(size: ArrayLike, wall: float, material: Material) -> Mesh:
    """Return an open box about the origin with walls of a thickness, of as few triangles as it takes."""
    half = 0.5 * np.asarray(size)
    around = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    outer, inner = around * half[[0, 2]], around * (half[[0, 2]] - wall)
    heights = (-half[1], half[1], half[1], wall - half[1])
    rings = [np.insert(ring, 1, y, axis=1) for ring, y in zip((outer, outer, inner, inner), heights, strict=True)]
    quads = [
        (4 * k + i, 4 * (k + 1) + i, 4 * (k + 1) + (i + 1) % 4, 4 * k + (i + 1) % 4) for k in range(3) for i in range(4)
    ]
    quads += [(0, 1, 2, 3), (15, 14, 13, 12)]
    return make_mesh([Part("crate", np.concatenate(rings), _triangles(quads), flat=True)], [material])


def sheet_crate(size: ArrayLike, cells: int, material: Material) -> Mesh:
    """Return an open box about the origin of five sheets without thickness, each of cells x cells squares."""
    step = np.linspace(-1.0, 1.0, cells + 1)
    s, t = (g.ravel() for g in np.meshgrid(step, step, indexing="ij"))
    one = np.ones_like(s)
    sides = [(s, -one, t), (s, t, -one), (s, t, one), (-one, s, t), (one, s, t)]
    i, j = np.meshgrid(np.arange(cells), np.arange(cells), indexing="ij")
    a = (i * (cells + 1) + j).ravel()
    quads = np.stack([a, a + 1, a + cells + 2, a + cells + 1], axis=-1)
    parts = [
        Part(f"sheet {k}", 0.5 * np.asarray(size) * np.stack(side, -1), _triangles(quads), flat=True)
        for k, side in enumerate(sides)
    ]
    return make_mesh(parts, [material])


def _triangles(quads: object) -> np.ndarray:
    quad = np.asarray(quads)
    return np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])


GREY, RED, WOOD = diffuse((0.5, 0.5, 0.5)), diffuse((0.75, 0.08, 0.06)), diffuse((0.60, 0.42, 0.25))
GOLD = Material(base_color=(0.95, 0.72, 0.40, 1.0), metallic=1.0, roughness=0.3)


_CRATE = np.array([0.9, 0.4, 0.7])
_WALL_M, _LIFT_M = 0.04, 2e-3
"""Thickness of the crate's walls; height of the sheets' floor above the ground, with which it would coincide."""


def _crate_scene(name: str, mesh: Mesh, lift_m: float, inset_m: float) -> Scene:
    """Return a crate below the camera; its hollow ends inset_m within its extent, at the near side always."""
    place = np.array([0.0, FLOOR_Y_M + 0.5 * _CRATE[1] + lift_m, -1.15])
    inside = np.stack([place - 0.5 * _CRATE + inset_m, place + 0.5 * _CRATE - inset_m])
    inside[1, 2] -= 2.0 * abs(inset_m)
    return Scene(name, (placed(mesh, tuple(place)),), (0.05, FLOOR_Y_M, -1.2), 90.0, inside)


SCENES = {
    scene.name: scene
    for scene in (
        Scene(
            "balls",
            (
                ball(0.30, -0.75, -2.3, diffuse((0.8, 0.8, 0.8))),
                ball(0.40, 0.05, -2.9, RED),
                ball(0.20, 0.30, -1.9, diffuse((0.2, 0.2, 0.2))),
                ball(0.25, 0.95, -2.5, GREY, gap=0.25),
            ),
        ),
        _crate_scene("crate", crate(_CRATE, _WALL_M, WOOD), 0.0, 0.5 * _WALL_M),
        _crate_scene("sheets", sheet_crate(_CRATE, 16, replace(WOOD, double_sided=True)), _LIFT_M, -1e-3),
        Scene("torus", (placed(torus(0.40, 0.14, GREY), (0.0, FLOOR_Y_M + 0.14, -1.9)),), (0.1, FLOOR_Y_M, -1.9)),
        Scene(
            "touching",
            (
                ball(0.30, -0.3, -2.1, diffuse((0.8, 0.8, 0.8))),
                ball(0.30, 0.3, -2.1, diffuse((0.1, 0.2, 0.7))),
                ball(0.30, 0.0, -2.1 - 0.3 * 3.0**0.5, GREY),
            ),
        ),
        Scene("metal", (ball(0.35, -0.35, -2.1, GOLD), ball(0.30, 0.35, -2.1, diffuse((0.7, 0.7, 0.7))))),
        Scene(
            "paved",
            (ball(0.35, -0.5, -2.2, GOLD), ball(0.30, 0.35, -2.1, diffuse((0.7, 0.7, 0.7)), gap=0.1)),
            paving_m=1.0,
        ),
    )
}
