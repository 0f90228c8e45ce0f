# SPDX-License-Identifier: Apache-2.0
"""Both eyes of a stereo plate: disparity, agreement with cameras at the eyes' own points, cost.

Run by `python benchmarks/camera.py stereo`. Prints, for each renderer, the disparity of a sphere at 2 m against the
closed form (target 0.1 pixel), and the PSNR of pixels of both eyes against reference renders of single cameras at the
points of the viewing circle that the pixels are seen from (target 45 dB); then frames of a moving body over a floor of
the sample dive's kind, of both eyes and of one (target: a stereo rate of 0.45 of the mono rate), in CPU time.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import replace
from typing import Any

import numpy as np

from mr360uw.base.cache import Cache
from mr360uw.base.color import encode
from mr360uw.base.sphere import direction_from_angles
from mr360uw.composite import PlacedObject, Shot
from mr360uw.composite.mesh.material import Material, Part
from mr360uw.composite.mesh.mesh import Mesh, make_mesh
from mr360uw.composite.motion import rigid, rotation_matrix
from mr360uw.composite.settings import DrawSettings
from mr360uw.composite.shot import Receiver
from mr360uw.composite.tiles import over
from mr360uw.render.frame import make_backend
from mr360uw.types import Environment, Sun, View

HALF_M, RADIUS_M, DISTANCE_M = 0.032, 0.25, 2.0
TARGET_PX, TARGET_DB, TARGET_RATE = 0.1, 45.0, 0.45
WIDTH, FRAMES = 1024, 7
PLACES = ((150, 140), (134, 118), (138, 170), (156, 183))
"""Columns and rows of 256 x 128 seen on the bodies, their edges and their shadows (halved in height)."""


def ball(rows: int, radius: float) -> Mesh:
    """Return a sphere."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, 2 * rows + 1), indexing="ij")
    latitude, longitude = np.pi * (0.5 - v), 2 * np.pi * u
    unit = [np.cos(latitude) * np.sin(longitude), np.sin(latitude), np.cos(latitude) * np.cos(longitude)]
    points = np.stack(unit, axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rows), np.arange(2 * rows), indexing="ij")
    a = (i * (2 * rows + 1) + j).ravel()
    below = a + 2 * rows + 1
    faces = np.concatenate([np.stack([a, below, a + 1], -1), np.stack([a + 1, below, below + 1], -1)])
    return make_mesh([Part("ball", radius * points, faces, points, None)], [Material(base_color=(0.7, 0.5, 0.3, 1.0))])


def scene(width: int, *bodies: PlacedObject, floor: bool = True) -> Shot:
    """Return a shot in even light with a sun, over a floor that catches shadows."""
    even = np.full((32, 64, 3), 0.3, np.float32)
    sun = Sun(direction_from_angles(0.7, 0.9), np.full(3, 2.0), 0.0047, 1.0)
    none = np.zeros((0, 32, 64, 3), np.float32)
    light = Environment(even, np.pi * even, sun, even, np.pi * even, none, np.zeros(0))
    receiver = Receiver(plane_y=-1.2, extent_m=8.0) if floor else None
    return Shot(View(width, width // 2), bodies, light, (sun,), receiver=receiver, draw=DrawSettings(sun_spread_deg=0))


def seen_from(shot: Shot, **view: Any) -> Shot:
    """Return a shot from another view."""
    return replace(shot, view=replace(shot.view, **view))


def codes(shot: Shot, backend: Any) -> np.ndarray:
    """Return the composite over an even plate, in code values."""
    plate = np.full((shot.view.height, shot.view.width, 3), 0.4, np.float32)
    return 255.0 * encode(np.clip(over(plate, backend.layer(shot)[0]), 0.0, 1.0), "srgb")


def disparity(backend: Any) -> float:
    """Return the largest error [pixels] of the sphere's disparity."""
    shot = scene(WIDTH, PlacedObject(ball(96, RADIUS_M), rigid((0.0, 0.0, -DISTANCE_M), np.eye(3))), floor=False)
    middle = []
    for eye_m in (-HALF_M, HALF_M):
        alpha = backend.layer(seen_from(shot, eye_m=eye_m))[0].alpha[WIDTH // 4]
        middle.append(float(np.sum(alpha * (np.arange(WIDTH) + 0.5)) / np.sum(alpha)))
    expected = np.arcsin((HALF_M + RADIUS_M) / DISTANCE_M) + np.arcsin((HALF_M - RADIUS_M) / DISTANCE_M)
    return abs(middle[0] - middle[1] - float(expected) * WIDTH / (2 * np.pi))


def agreement(backend: Any, reference: Any) -> float:
    """Return the least PSNR [dB] of pixels of both eyes against cameras at the points that they are seen from."""
    crate = PlacedObject(ball(4, 0.4), rigid((-0.3, -0.4, -1.0), rotation_matrix((20.0, 0.0, 10.0))))
    shot = scene(256, PlacedObject(ball(24, 0.5), rigid((0.6, -0.5, -1.6), np.eye(3))), crate)
    worst = np.inf
    for eye_m in (-HALF_M, HALF_M):
        eye = seen_from(shot, eye_m=eye_m)
        whole = codes(eye, backend)
        for column, row in PLACES:
            at = row // 2, slice(column - 2, column + 3)
            own = eye.view.starts(eye.view.directions(column + 0.5, row // 2 + 0.5))
            alone = codes(seen_from(shot, position=own), reference)
            worst = min(worst, 10.0 * np.log10(255.0**2 / max(np.mean((whole[at] - alone[at]) ** 2), 1e-9)))
    return float(worst)


def seconds(backend: Any, eyes: tuple[float, ...], *, moving: bool) -> float:
    """Return the median CPU time [s] of a frame that all eyes see."""
    body, spent = ball(48, 0.5), []
    for frame in range(FRAMES):
        place = rigid((0.02 * frame * moving, -0.6, -1.8), np.eye(3))
        shot = scene(WIDTH, PlacedObject(body, place))
        began = time.process_time()
        for eye_m in eyes:
            backend.layer(seen_from(shot, eye_m=eye_m))
        spent.append(time.process_time() - began)
    return statistics.median(spent[2:])


def measure() -> None:
    """Print disparity, agreement and rate."""
    reference = make_backend("reference")[0]
    backends = [reference, *(b for b in [make_backend("auto", Cache(2))[0]] if b.name == "gl")]
    for backend in backends:
        error, least = disparity(backend), agreement(backend, reference)
        met = "met" if error <= TARGET_PX else "MISSED"
        print(
            f"{backend.name:10s} disparity of a sphere at 2 m: off by {error:.3f} pixels  (target {TARGET_PX}, {met})"
        )
        met = "met" if least >= TARGET_DB else "MISSED"
        print(f"{'':10s} against cameras at the eyes' points: {least:.1f} dB at worst  (target {TARGET_DB:.0f}, {met})")
    for moving in (True, False):
        one = seconds(make_backend("auto")[0], (0.0,), moving=moving)
        two = seconds(make_backend("auto", Cache(2))[0], (-HALF_M, HALF_M), moving=moving)
        met = "met" if one / two >= TARGET_RATE else "MISSED"
        kind = "a body that moves" if moving else "a body at rest"
        rate = f"rate {one / two:.2f}  (target {TARGET_RATE}, {met})"
        print(f"layer, {kind}: {one:.3f} s of one eye, {two:.3f} s of both, {rate}")
