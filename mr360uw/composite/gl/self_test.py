# SPDX-License-Identifier: Apache-2.0
"""Self-test of OpenGL on this machine: small pictures by both renderers, their differences, and how long they take."""

from __future__ import annotations

import functools
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mr360uw.base.cache import Cache
from mr360uw.base.color import encode
from mr360uw.base.disk_cache import kept_arrays
from mr360uw.base.sphere import directions, row_solid_angle, unit
from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.mesh.material import Material, Part, make_texture
from mr360uw.composite.mesh.mesh import Mesh, make_mesh
from mr360uw.composite.motion import rigid, rotation_matrix
from mr360uw.composite.reference import render_layer
from mr360uw.composite.settings import DrawSettings
from mr360uw.composite.shot import PlacedObject, Receiver, Shot
from mr360uw.composite.tiles import over
from mr360uw.errors import GlError
from mr360uw.gl import gl_context, gl_device
from mr360uw.types import CausticStack, Environment, Floats, Layer, MediumTable, Sun, View

PSNR_DB = 45.0
"""Least PSNR of OpenGL against the reference over a frame: what a compositor does not see in a difference picture."""
CODES = 2.0
"""8-bit code values that OpenGL may be off by ..."""
FRACTION = 0.999
"""... in so many of the pixels."""

_WIDTH, _SEED, _DRAWN = 128, 360, 5
_LIMITS = ("GL_MAX_TEXTURE_SIZE", "GL_MAX_ARRAY_TEXTURE_LAYERS", "GL_MAX_TEXTURE_IMAGE_UNITS", "GL_MAX_DRAW_BUFFERS",
           "GL_MAX_COLOR_ATTACHMENTS", "GL_MAX_FRAGMENT_UNIFORM_COMPONENTS")  # fmt: skip


@dataclass(frozen=True, slots=True)
class Trial:
    """One picture by OpenGL against the reference's.

    problem: what is wrong with it, "" for nothing. first_s: time [s] of its first drawing, which compiles shaders.
    again_s: of the drawings after that with nothing kept, a median. reference_s: of the reference renderer.
    """

    name: str
    problem: str
    first_s: float
    again_s: float
    reference_s: float

    def __str__(self) -> str:
        times = f"first {self.first_s:6.2f} s, then {1e3 * self.again_s:6.1f} ms, reference {self.reference_s:5.2f} s"
        return f"trial     {self.name:<9}  {times}  {self.problem or 'agrees'}"


def run_trials(names: Sequence[str] = (), width: int = _WIDTH) -> tuple[Trial, ...]:
    """Draw small pictures with both renderers. names: of `eight_shots`; all without any.

    Raises `GlError` where there is no OpenGL; what goes wrong with one picture is told by its trial.
    """
    gl_context()
    shots = eight_shots(np.random.default_rng(_SEED), width)
    return tuple(_trial(name, shots[name]) for name in names or shots)


def _trial(name: str, shot: Shot) -> Trial:
    since = time.perf_counter()
    expected = _codes(render_layer(shot), shot)
    reference_s, again = time.perf_counter() - since, [0.0]
    since = time.perf_counter()
    try:
        cache = Cache()
        renderer = LayerRenderer(cache)
        problem = _difference(_codes(renderer.render(shot), shot), expected)
        first_s, again = time.perf_counter() - since, []
        for _ in range(_DRAWN):
            cache.clear()
            since = time.perf_counter()
            renderer.render(shot)
            again.append(time.perf_counter() - since)
    except GlError as error:
        problem, first_s = str(error), time.perf_counter() - since
    return Trial(name, problem, first_s, statistics.median(again), reference_s)


def _codes(layer: Layer, shot: Shot) -> Floats:
    return codes(over(plate(shot.view.width), layer))


def _difference(got: Floats, expected: Floats) -> str:
    """Return how a picture (H, W, 3) in codes differs from what it ought to be, "" where it agrees."""
    off = np.abs(got - expected)
    share = float(np.mean(off.max(axis=-1) <= CODES))
    psnr_db = 20.0 * float(np.log10(255.0 / max(float(np.sqrt(np.mean(off**2))), 1e-9)))
    if share >= FRACTION and psnr_db >= PSNR_DB:
        return ""
    return (
        f"differs from the reference: {100 * share:.2f} % of the pixels within {CODES:g} codes, PSNR {psnr_db:.1f} dB"
    )


def report(trials: Sequence[Trial]) -> str:
    """Return several lines: limits of the device, one for each trial, and what they say together."""
    info = gl_context().info
    limits = ", ".join(f"{name.removeprefix('GL_MAX_').lower()} {info[name]}" for name in _LIMITS if name in info)
    wrong = [trial for trial in trials if trial.problem]
    verdict = (
        f"{len(wrong)} of {len(trials)} pictures are wrong here: take --backend reference, and send this report"
        if wrong
        else f"all {len(trials)} pictures agree with the reference renderer"
    )
    return "\n".join([f"limits    {limits}", *map(str, trials), f"verdict   {verdict}"])


def doubt_of_device() -> str:
    """Return why a graphics card shall not draw here, "" for nothing, by one small picture.

    It is drawn once for a card and a driver, and not with a driver that renders on the processor, as tests do.
    """
    device = gl_device()
    return "" if device.software else _doubt_of(device.renderer, device.version)


@functools.cache  # for users of whom nothing is kept on the disk
def _doubt_of(renderer: str, version: str) -> str:
    return str(kept_arrays("card", (renderer, version), _first_trial)["problem"])


def _first_trial() -> dict[str, Floats]:
    (trial,) = run_trials(("materials",), _WIDTH // 2)
    return {"problem": np.array(trial.problem)}


SUN = Sun(unit([0.3, 0.9, -0.2]), np.array([1.2, 1.5, 1.4]), 0.03, 1.0)


@functools.cache
def environment(constant: float | None = None) -> Environment:
    """Return the light of a sea, brighter from above, or the same from everywhere."""
    d = directions(64, 32)
    radiance = np.array([0.12, 0.35, 0.45]) * (0.55 + 0.45 * d[..., 1:2]) ** 2 + 0.02
    if constant is not None:
        radiance = np.full((32, 64, 3), constant)
    flat = d.reshape(-1, 3)
    weight = np.repeat(row_solid_angle(64, 32), 64)
    cosine = np.maximum(flat @ flat.T, 0.0)

    def lobe(power: float) -> Floats:
        kernel = cosine**power * weight
        kernel /= kernel.sum(axis=1, keepdims=True)
        return (kernel @ radiance.reshape(-1, 3)).reshape(32, 64, 3)

    ambient = np.pi * lobe(1.0)
    glossy = np.stack([lobe(100.0), lobe(20.0), lobe(5.0), lobe(2.0)])
    return Environment(radiance, ambient, None, radiance, ambient, glossy, np.array([0.1, 0.3, 0.6, 1.0]))


def medium(camera_depth_m: float = 5.0, absorption: tuple[float, ...] = (0.35, 0.06, 0.04)) -> MediumTable:
    """Return a water whose veil saturates to one colour and that takes light off exponentially."""
    a = np.asarray(absorption)
    far = np.array([0.02, 0.12, 0.2])
    length, count = 8.0, 64
    t = np.linspace(0.0, 1.0, count)
    s = length * t[:-1] / (1.0 - t[:-1])
    ratio = np.ones((count, 3))
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio[:-1] = np.where(s[:, None] > 0, -np.expm1(-a * s[:, None]) / -np.expm1(-s[:, None] / length), a * length)
    veil = np.broadcast_to(far * ratio, (17, count, 3)).copy()
    table = np.broadcast_to(a, (32, 3)).copy()
    even = np.broadcast_to(a, (9, 8, 3)).copy()
    return MediumTable(camera_depth_m, length, veil, even, np.stack([table, table]), table, 1.5 * table)


def caustics(rng: np.random.Generator, *, softened: bool = False) -> CausticStack:
    """Return a random pattern of mean 1 on three planes, and if asked for another one of light that has turned."""
    ratio = rng.uniform(0.4, 1.6, (3, 32, 32, 3))
    ratio /= ratio.mean(axis=(1, 2), keepdims=True)
    soft = None
    if softened:
        soft = rng.uniform(0.4, 1.6, (3, 32, 32, 1))
        soft /= soft.mean(axis=(1, 2), keepdims=True)
    return CausticStack(ratio, np.array([2.0, 6.0, 12.0]), 4.0, SUN.direction, soft)


def sphere(rows: int = 24, material: Material | None = None, radius: float = 0.5) -> Mesh:
    """Return a sphere with texture coordinates."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, 2 * rows + 1), indexing="ij")
    latitude, longitude = np.pi * (0.5 - v), 2 * np.pi * u
    normals = np.stack(
        [np.cos(latitude) * np.sin(longitude), np.sin(latitude), np.cos(latitude) * np.cos(longitude)], axis=-1
    )
    columns = 2 * rows + 1
    i, j = np.meshgrid(np.arange(rows), np.arange(2 * rows), indexing="ij")
    a = (i * columns + j).ravel()
    b, c, d = a + 1, a + columns, a + columns + 1
    faces = np.concatenate([np.stack([a, c, b], -1), np.stack([b, c, d], -1)])
    flat = normals.reshape(-1, 3)
    part = Part("sphere", radius * flat, faces, flat, np.stack([u, v], -1).reshape(-1, 2))
    return make_mesh([part], [material or Material()])


def quad(material: Material | None = None, size: float = 1.0) -> Mesh:
    """Return a square in the x, y plane that faces +z."""
    corners = 0.5 * size * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], float)
    part = Part("quad", corners, np.array([[0, 1, 2], [0, 2, 3]]), None, uv)
    return make_mesh([part], [material or Material(double_sided=True)])


def box(size: tuple[float, float, float] = (1.0, 1.0, 1.0), material: Material | None = None) -> Mesh:
    """Return a box about the origin with sharp edges."""
    low = -0.5 * np.asarray(size)
    points = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(8, 3) * size + low
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])
    return make_mesh([Part("box", points, faces)], [material or Material()])


def checker(rng: np.random.Generator, alpha: bool = False) -> Material:
    """Return a material with base, metallic-roughness and normal maps; with `alpha` half of the base is clear."""
    size = 64
    squares = ((np.arange(size)[:, None] // 8 + np.arange(size) // 8) % 2).astype(np.uint8)
    base = np.stack([200 - 120 * squares, 60 + 100 * squares, 90 + 0 * squares], axis=-1).astype(np.uint8)
    if alpha:
        base = np.concatenate([base, 255 * squares[..., None]], axis=-1)
    orm = np.stack([255 - 60 * squares, 40 + 160 * squares, 200 * squares], axis=-1).astype(np.uint8)
    bump = np.full((size, size, 3), 128, np.uint8)
    bump[..., :2] = np.clip(128 + 25 * rng.normal(size=(size, size, 2)), 0, 255)
    bump[..., 2] = 250
    orm_map = make_texture(orm, srgb=False)
    return Material(
        base_color=(1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=1.0, double_sided=alpha,
        base_map=make_texture(base, srgb=True), metallic_roughness_map=orm_map, occlusion_map=orm_map,
        normal_map=make_texture(bump, srgb=False), emission=(0.02, 0.0, 0.0),
    )  # fmt: skip


def placed(
    mesh: Mesh, position: tuple[float, ...], rotation: tuple[float, ...] = (0, 0, 0), **more: Any
) -> PlacedObject:
    """Return a mesh in the world."""
    scale = more.pop("scale", 1.0)
    return PlacedObject(mesh, rigid(position, rotation_matrix(rotation), scale), **more)


_DRAW = set(DrawSettings.model_fields)


def shot(*objects: PlacedObject, width: int = 128, **more: Any) -> Shot:
    """Return a shot with sun and sea light, 2:1."""
    view = View(
        width, width // 2, more.pop("camera_position", np.zeros(3)), more.pop("world_from_camera", np.eye(3)),
        more.pop("surface_y_m", 5.0),
    )  # fmt: skip
    draw = DrawSettings(**{"sun_spread_deg": 0.0, **{name: more.pop(name) for name in _DRAW & set(more)}})
    sun = more.pop("sun", SUN)
    lights = (*(() if sun is None else (sun,)), *more.pop("lamps", ()))
    return Shot(view, objects, more.pop("environment", None) or environment(), lights, draw=draw, **more)


def plate(width: int) -> Floats:
    """Return a plate (H, W, 3): water above a pale floor."""
    d = directions(width, width // 2)
    water = np.array([0.05, 0.25, 0.4]) * (0.6 + 0.4 * d[..., 1:2])
    distance = np.where(d[..., 1] < -0.02, 2.0 / np.maximum(-d[..., 1], 1e-3), 1e3)
    floor = np.exp(-0.15 * distance)[..., None]
    return (water * (1 - floor) + floor * np.array([0.35, 0.36, 0.3])).astype(np.float32)


def codes(image_linear: Floats) -> Floats:
    """Return 8-bit code values, not rounded."""
    return 255.0 * encode(np.clip(image_linear, 0.0, 1.0), "srgb")


def eight_shots(rng: np.random.Generator, width: int = 128) -> dict[str, Shot]:
    """Return the scenes on which the renderers are compared."""
    ball, cube = sphere(), box((0.6, 0.5, 0.4), Material(base_color=(0.6, 0.3, 0.2, 1.0), roughness=0.4))
    rich = sphere(material=checker(rng))
    masked = quad(replace(checker(rng, alpha=True), alpha_mode="MASK", normal_map=None))
    blended = quad(Material(base_color=(0.8, 0.2, 0.2, 0.4), alpha_mode="BLEND", double_sided=True))
    floor = Receiver(plane_y=-1.2)
    column, row = np.meshgrid(np.arange(width), np.arange(width // 2))
    matte = np.clip((column - 0.5 * width) / (0.05 * width) + 0.5, 0.0, 1.0)
    deep = medium(25.0)
    return {
        "materials": shot(placed(rich, (-0.7, 0.0, -1.6)), placed(cube, (0.7, 0.0, -1.4), (30, 20, 10)), width=width),
        "alpha": shot(
            placed(masked, (-0.4, 0.1, -1.5), (20, 0, 0)), placed(blended, (0.4, 0.0, -1.2), (-10, 0, 0)),
            placed(ball, (0.4, 0.0, -2.0)), width=width,
        ),
        "seam": shot(placed(rich, (0.1, 0.1, 1.5)), placed(cube, (-0.8, 0.3, 1.2), (10, 0, 0)), width=width),
        "zenith": shot(placed(cube, (0.05, 1.3, -0.1), (20, 10, 0)), width=width),
        "nadir": shot(placed(rich, (0.1, -1.4, 0.05)), width=width),
        "deep": shot(
            placed(ball, (0.3, -0.3, -1.8)), placed(cube, (-0.8, -0.2, -1.6)), width=width, medium=deep,
            surface_y_m=25.0, receiver=floor, sun_spread_deg=np.degrees(0.09),
        ),
        "shadow": shot(
            placed(ball, (0.4, -0.6, -1.8)), placed(cube, (-0.6, -0.95, -1.6), (25, 0, 0)), width=width,
            medium=medium(), caustics=caustics(rng), receiver=replace(floor, caustics=True, extent_m=8.0),
        ),
        "holdout": shot(
            placed(rich, (0.0, -0.2, -1.6)), width=width, receiver=floor, holdout=matte,
            holdout_distance_m=np.where(row < 0.45 * width // 2, 1.3, np.inf),
        ),
    }  # fmt: skip
