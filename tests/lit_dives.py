# SPDX-License-Identifier: Apache-2.0
"""Path-traced dives with a ball and a box near a bright floor, and the composites that are held to them.

A plate without bodies and the mean radiance of regions with them are in tests/data/lit_dives.npz, made by
benchmarks/dive_truth.py. Each channel is a water of its own at one wavelength. The sun stands over the middle of the
frame, so that half of the plate tells the other.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mr360uw.base.optics import fresnel_from_below, refract_to_water
from mr360uw.base.sphere import directions, row_solid_angle
from mr360uw.medium.open_water import DARKEST
from mr360uw.medium.phase import Phase
from mr360uw.runs.compositor import FrameResult, render_frame
from mr360uw.scene import scene_from_dict

DATA = Path(__file__).parent / "data" / "lit_dives.npz"
PLATE, SIZE = (64, 128), (192, 384)
"""Height and width of stored plates and of composites."""
CHANNEL_NM = (650.0, 550.0, 450.0)
_BALL, _BOX = (0.9, -0.55, -0.9, 0.3), (-0.8, -0.75, 0.7, 0.28, 0.25, 0.2)
"""Middle and radius, middle and half sizes, for a camera 1 m above the floor."""
_YAW = np.radians(-40.0)
_ALBEDO = 0.5
_CLEAR = 1.25
"""Radii about a body within which the floor shows too much of it to be called free."""


@dataclass(frozen=True)
class LitDive:
    """A dive. depth_m, height_m: of the camera below the surface and above the floor. sun_deg: elevation in air.

    sun_share: fraction of the irradiance below the surface that is the sun's. All light there together is 1.
    """

    depth_m: float
    height_m: float
    absorption: tuple[float, float, float]
    scattering: tuple[float, float, float]
    phase: Phase
    floor_albedo: tuple[float, float, float]
    sun_deg: float
    sun_share: float = 0.65
    refractive_index: float = 1.34

    @property
    def sun(self) -> np.ndarray:
        """Direction (3,) to the sun in the water."""
        e = np.radians(self.sun_deg)
        return refract_to_water(np.array([0.0, np.sin(e), -np.cos(e)]), self.refractive_index)

    @property
    def sun_irradiance(self) -> float:
        """Irradiance of the beam just below the surface, perpendicular to it."""
        return self.sun_share / float(self.sun[1])

    @property
    def sky_radiance(self) -> float:
        """Radiance of an even sky in the water, before what the surface reflects."""
        mu = (np.arange(20000) + 0.5) / 20000
        passed = 2.0 * np.mean((1.0 - fresnel_from_below(mu, self.refractive_index)) * mu)
        return float((1.0 - self.sun_share) / np.pi / passed)

    @property
    def ball(self) -> tuple[float, ...]:
        """Middle, radius and albedo."""
        return (*(self.height_m * np.array(_BALL)), _ALBEDO)

    @property
    def box(self) -> tuple[float, ...]:
        """Middle, half sizes, cosine and sine of its yaw, albedo."""
        return (*(self.height_m * np.array(_BOX)), np.cos(_YAW), np.sin(_YAW), _ALBEDO)


_SEA, _CLEAR_SEA = ((0.30, 0.06, 0.03), (0.10, 0.22, 0.19)), ((0.28, 0.07, 0.02), (0.05, 0.06, 0.07))
DIVES = {
    "sand": LitDive(3.5, 1.5, *_SEA, ("hg", 0.85), (0.45, 0.40, 0.32), 55.0),
    "white": LitDive(1.5, 1.0, *_CLEAR_SEA, ("hg", 0.90), (0.50, 0.50, 0.48), 70.0),
    "deep": LitDive(11.0, 2.0, *_CLEAR_SEA, "petzold", (0.30, 0.28, 0.24), 50.0, 0.75),
    "dark": LitDive(5.0, 3.0, *_SEA, ("hg", 0.95), (0.10, 0.10, 0.10), 30.0),
    "near": LitDive(4.0, 0.5, *_SEA, "petzold", (0.40, 0.34, 0.26), 40.0),
    "green": LitDive(2.5, 1.2, (0.35, 0.20, 0.15), (0.50, 0.55, 0.60), ("hg", 0.90), (0.40, 0.35, 0.30), 50.0, 0.6),
    "turbid": LitDive(2.0, 1.5, (0.40, 0.15, 0.20), (0.80, 0.90, 1.00), ("hg", 0.92), (0.25, 0.25, 0.20), 60.0, 0.5),
}


def regions_of(dive: LitDive) -> dict[str, np.ndarray]:
    """Return masks (H, W) of the pixels that lie wholly in a region."""
    d = half_pixel_rays()
    kind, point, normal = _seen(dive, np.zeros(3), d)
    facing = normal @ dive.sun
    floor, free = kind == 1, np.ones(kind.shape, bool)
    lit = _seen(dive, point + 1e-5 * normal, np.broadcast_to(dive.sun, point.shape))[0] < 2
    beside = 0.02 * dive.height_m * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]])
    around = [_seen(dive, point + 1e-5 * normal + b, np.broadcast_to(dive.sun, d.shape))[0] >= 2 for b in beside]
    for body, wide in ((dive.ball[:3], dive.ball[3]), (dive.box[:3], float(np.hypot(dive.box[3], dive.box[5])))):
        free &= np.hypot(point[..., 0] - body[0], point[..., 2] - body[2]) > _CLEAR * wide
    ball, box = kind == 2, kind == 3
    near = np.linalg.norm(point, axis=-1) < 4.0 * dive.height_m
    found = {
        "ball": ball, "ball, lit": ball & (facing > 0.3), "ball, away from the sun": ball & (facing < -0.1),
        "ball, below": ball & (normal[..., 1] < -0.5), "box": box, "box, top": box & (normal[..., 1] > 0.5),
        "box, lit side": box & (np.abs(normal[..., 1]) < 0.5) & (facing > 0.05),
        "box, away from the sun": box & (np.abs(normal[..., 1]) < 0.5) & (facing < 0.0),
        "umbra": floor & np.logical_and.reduce(around) & ~lit & near, "floor": floor & lit & free & near,
    }  # fmt: skip
    return whole_pixels(found)


def half_pixel_rays() -> np.ndarray:
    """Return directions (2 H + 1, 2 W + 1, 3) of the corners, the middles and the middles of the sides of pixels."""
    height, width = SIZE
    rows, columns = np.meshgrid(np.arange(2 * height + 1) / 2.0, np.arange(2 * width + 1) / 2.0, indexing="ij")
    lat, lon = np.pi * (0.5 - rows / height), 2.0 * np.pi * (columns / width - 0.5)
    return np.stack([np.cos(lat) * np.sin(lon), np.sin(lat), -np.cos(lat) * np.cos(lon)], axis=-1)


def whole_pixels(found: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return masks (H, W) of the pixels all of whose `half_pixel_rays` are in a mask, where these are 12 or more."""
    height, width = SIZE
    inside = {}
    for name, mask in found.items():
        nine = [mask[i : i + 2 * height - 1 : 2, j : j + 2 * width - 1 : 2] for i in range(3) for j in range(3)]
        whole = np.logical_and.reduce(nine)
        if np.count_nonzero(whole) >= 12:
            inside[name] = whole
    return inside


def _seen(dive: LitDive, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return kind (0 water, 1 floor, 2 ball, 3 box), point and normal (..., 3) that rays see first."""
    ball, box = np.array(dive.ball), np.array(dive.box)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_floor = np.where(d[..., 1] < 0.0, (-dive.height_m - o[..., 1]) / d[..., 1], np.inf)
        away = o - ball[:3]
        b = np.sum(away * d, -1)
        q = b * b - np.sum(away * away, -1) + ball[3] ** 2
        to_ball = np.where(q > 0.0, -b - np.sqrt(np.maximum(q, 0.0)), np.inf)
        to_ball = np.where(to_ball > 1e-6, to_ball, np.inf)
        turn = np.array([[box[6], 0.0, -box[7]], [0.0, 1.0, 0.0], [box[7], 0.0, box[6]]])
        lo, ld = (o - box[:3]) @ turn.T, d @ turn.T
        one, two = (-box[3:6] - lo) / ld, (box[3:6] - lo) / ld
        near, far = np.minimum(one, two), np.maximum(one, two).min(-1)
        axis, first = near.argmax(-1), near.max(-1)
        to_box = np.where((first < far) & (first > 1e-6), first, np.inf)
    distance = np.stack([np.full(to_floor.shape, 1e9), to_floor, to_ball, to_box])
    kind, reach = distance.argmin(0), distance.min(0)
    point = o + reach[..., None] * d
    side = -np.sign(np.take_along_axis(ld, axis[..., None], -1)) * np.eye(3)[axis]
    normal = np.broadcast_to([0.0, 1.0, 0.0], d.shape).copy()
    normal[kind == 2], normal[kind == 3] = ((point - ball[:3]) / ball[3])[kind == 2], (side @ turn)[kind == 3]
    return kind, point, normal


def plate_of(name: str) -> np.ndarray:
    """Return the plate (H, W, 3) of a dive, its sun in one pixel."""
    dive, half = DIVES[name], _stored()[f"{name}/plate"].astype(np.float32)
    whole = np.concatenate([half, half[:, ::-1]], axis=1)
    wide = np.concatenate([whole[:, -4:], whole, whole[:, :4]], axis=1)
    scale = SIZE[0] // PLATE[0]
    image = cv2.resize(wide, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)[:, 4 * scale : -4 * scale]
    view, c = directions(SIZE[1], SIZE[0]), np.array(dive.absorption) + dive.scattering
    place = np.unravel_index(np.argmax(view @ dive.sun), SIZE)
    solid = row_solid_angle(SIZE[1], SIZE[0])[place[0]]
    beam = dive.sun_irradiance * np.exp(-c * dive.depth_m / dive.sun[1])
    # between two columns, for the sun stands over the middle of the frame
    image[place[0], [SIZE[1] // 2 - 1, SIZE[1] // 2]] += (0.5 * beam / solid).astype(np.float32)
    return np.ascontiguousarray(image)


@functools.cache
def _stored() -> dict[str, Any]:
    return dict(np.load(DATA))


def composed(name: str, backend: str, folder: Path, plate: np.ndarray | None = None, **tables: Any) -> FrameResult:
    """Return the composite of a dive's plate with a ball and a box. plate: None takes the dive's own."""
    dive = DIVES[name]
    _write_water(dive, folder)
    (folder / "ball.obj").write_text(_ball())
    (folder / "box.obj").write_text(_box())
    (folder / "plate.png").touch()
    matt: dict[str, Any] = {
        "base_color": [_ALBEDO] * 3, "metallic": 0.0, "roughness": 1.0, "refractive_index": dive.refractive_index,
    }  # fmt: skip
    ball, box = dive.ball, dive.box
    objects = [
        {"mesh": "ball.obj", "position_m": list(ball[:3]), "scale": ball[3], "smooth_deg": 60.0} | matt,
        {"mesh": "box.obj", "position_m": list(box[:3]), "scale": dive.height_m, "smooth_deg": 0.0,
         "rotation_deg": [np.degrees(-_YAW), 0.0, 0.0]} | matt,
    ]  # fmt: skip
    water: dict[str, Any] = {
        "type": "csv", "csv": "water.csv", "sensor": str(folder / "sensor.csv"), "illuminant": "equal-energy",
        "refractive_index": dive.refractive_index,
    }  # fmt: skip
    water |= {"phase": dive.phase[1] if isinstance(dive.phase, tuple) else dive.phase}
    data = {
        "plate": {"path": "plate.png"}, "camera": {"depth_m": dive.depth_m}, "water": water,
        "receiver": {"height_m": -dive.height_m, "extent_m": 100.0}, "light": {"operator": "none"},
        "object": objects, "draw": {"samples": 5}, "caustics": {"enabled": False}, "shafts": {"mode": "off"},
    } | tables  # fmt: skip
    return render_frame(plate_of(name) if plate is None else plate, scene_from_dict(data, folder), 0.0, backend)


def compared(name: str, backend: str, folder: Path, **tables: Any) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Return for each region its name, the ratio (3,) of composite over truth, and the truth's relative noise (3,).

    A ninth of an 8-bit code near black counts as noise.
    """
    image = composed(name, backend, folder, **tables).image_linear.astype(np.float64)
    mean, noise = _stored()[f"{name}/mean"], _stored()[f"{name}/noise"]
    regions = regions_of(DIVES[name])
    return [
        (region, image[mask].mean(axis=0) / mean[k], (noise[k] + DARKEST / 3.0) / mean[k])
        for k, (region, mask) in enumerate(regions.items())
    ]


def _write_water(dive: LitDive, folder: Path) -> None:
    nm = np.array([400.0, 499.0, 501.0, 599.0, 601.0, 700.0])
    which = [2, 2, 1, 1, 0, 0]
    rows = [f"{w:g},{dive.absorption[k]:g},{dive.scattering[k]:g}" for w, k in zip(nm, which, strict=True)]
    (folder / "water.csv").write_text("\n".join(["wavelength_nm,absorption,scattering", *rows]))
    lines = ["wavelength_nm,R,G,B"]
    for w in np.arange(400.0, 701.0, 5.0):
        lines += [f"{w:g}," + ",".join(str(int(abs(w - peak) < 20.0)) for peak in CHANNEL_NM)]
    (folder / "sensor.csv").write_text("\n".join(lines))


def _ball(rows: int = 48, columns: int = 96) -> str:
    lat = np.pi * (np.arange(rows + 1) / rows - 0.5)
    lon = 2.0 * np.pi * np.arange(columns) / columns
    lines = []
    for a in lat:
        for o in lon:
            v = np.cos(a) * np.cos(o), np.sin(a), np.cos(a) * np.sin(o)
            lines.append("v {:.6f} {:.6f} {:.6f}".format(*v))
    for i in range(rows):
        for j in range(columns):
            k = (j + 1) % columns
            a, b, c, d = (1 + r * columns + q for r, q in ((i, j), (i, k), (i + 1, k), (i + 1, j)))
            lines += [f"f {a} {c} {b}", f"f {a} {d} {c}"]
    return "\n".join(lines)


def _box() -> str:
    x, y, z = _BOX[3:]
    corners = [(i, j, k) for i in (-x, x) for j in (-y, y) for k in (-z, z)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    lines = ["v {:g} {:g} {:g}".format(*corner) for corner in corners]
    for a, b, c, d in faces:
        lines += [f"f {a + 1} {b + 1} {c + 1}", f"f {a + 1} {c + 1} {d + 1}"]
    return "\n".join(lines)
