# SPDX-License-Identifier: Apache-2.0
"""How right and how fast light shafts are: python benchmarks/shafts.py [section ...], all of them without any.

truth: contrast of a ball's shadow in the water against a path tracer of single scattering, and what the choice of phase
function and attenuation is worth against one of all scattering. grid: froxels against rays of 4096 segments in six
scenes, over size and time. bands: three averaged bands against all wavelengths. cookie:
two scrolling maps instead of waves. cost: of a frame's layer without and with them.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.peers.mitsuba_scene import has_mitsuba, mitsuba  # noqa: E402
from mr360uw.base.cache import Cache  # noqa: E402
from mr360uw.base.sphere import direction_from_angles, unit  # noqa: E402
from mr360uw.caustics import (  # noqa: E402
    CausticSettings,
    GerstnerSea,
    caustic_stack,
    refract_to_air,
    stack_depths,
)
from mr360uw.medium import FroxelGrid, Medium, ShaftScene, Water, shaft_field  # noqa: E402
from mr360uw.medium.closed_form import exponential_integral  # noqa: E402
from mr360uw.medium.phase import wide_angle_function, wide_angle_moments  # noqa: E402
from mr360uw.medium.scattered_light import spread_of  # noqa: E402
from mr360uw.medium.shafts.shaft_field import DEFAULT_GRID, march  # noqa: E402
from mr360uw.medium.shafts.shaft_scene import ShaftWater  # noqa: E402
from mr360uw.medium.shafts.single_scattering import ray_ends_m, view_directions  # noqa: E402
from mr360uw.render.first_pass import clip_analysis  # noqa: E402
from mr360uw.render.frame import (  # noqa: E402
    draw_frame,
    frame_shots,
    make_backend,
)
from mr360uw.render.loaded import load  # noqa: E402
from mr360uw.render.plate_light import plate_light  # noqa: E402
from mr360uw.sample import sample_dive  # noqa: E402
from mr360uw.scene.model import Scene, load_scene  # noqa: E402
from mr360uw.scene.resolved import open_plate  # noqa: E402
from mr360uw.types import CausticStack, Lamp, Sun, View  # noqa: E402

DEPTH_M = 5.0
SUN_HALF_ANGLE = 0.0035
"""Angular radius [rad] of the sun's disc in the water."""


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball with exact ray tests, an `Occluder`. centre: (3,), radius [m]."""

    centre: np.ndarray
    radius: float

    @property
    def bounding_sphere(self) -> tuple[np.ndarray, float]:
        """Return the ball."""
        return self.centre, self.radius

    def distance(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return the distance (n,) at which rays meet the ball from the start on, infinity where they do not."""
        to = self.centre - origins
        along = np.sum(to * directions, axis=-1)
        half = self.radius**2 - np.sum(to * to, axis=-1) + along**2
        root = np.sqrt(np.maximum(half, 0.0))
        near = np.where(along > root, along - root, along + root)
        return np.where((half > 0.0) & (near > 0.0), near, np.inf)

    def occluded(self, origins: np.ndarray, directions: np.ndarray, reach_m: Any = np.inf) -> np.ndarray:
        """Return whether rays (n,) meet the ball nearer than `reach_m`."""
        return self.distance(origins, directions) < reach_m


def rms(x: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


def sun_at(elevation_deg: float, azimuth_deg: float = 35.0) -> Sun:
    """Return a sun of unit irradiance at an elevation in the water."""
    direction = direction_from_angles(np.radians(azimuth_deg), np.radians(elevation_deg))
    return Sun(direction, np.ones(3), SUN_HALF_ANGLE, 1.0)


# --- truth ---------------------------------------------------------------------------------------------------------

BALL = Ball(np.array([0.0, 1.0, -3.0]), 0.5)
_PIXELS, _FOV_DEG, _SAMPLES = 20, 30.0, 512
WATERS = {"thin": (0.05, 0.05, 0.0), "IB": (0.07, 0.18, 0.92), "1C": (0.12, 0.45, 0.92)}
"""Absorption, scattering [1/m] and mean cosine; the last two about those of the types at 550 nm."""


def path_traced(
    absorption: float, scattering: float, g: float, sun: Sun, target: np.ndarray, ball: bool, depth: int, seed: int = 7
) -> np.ndarray:
    """Return a square picture (n, n) from the origin towards a target in endless water below y = DEPTH_M.

    The sun has unit irradiance just below the surface. depth: most events on a path, 2 for single scattering. seed: the
    same with and without the ball, so that most paths are the same.
    """
    mi = mitsuba()
    transform = mi.ScalarTransform4f

    def grey(value: float) -> dict[str, Any]:
        return {"type": "rgb", "value": [value] * 3}

    phase = {"type": "hg", "g": g} if g else {"type": "isotropic"}
    c = absorption + scattering
    water = {"type": "homogeneous", "sigma_t": c, "albedo": grey(scattering / c), "phase": phase}
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": depth, "rr_depth": 64},
        "water": water,
        "sea": {
            "type": "cube", "bsdf": {"type": "null"}, "interior": {"type": "ref", "id": "water"},
            "to_world": transform().translate([0.0, DEPTH_M - 60.0, 0.0]).scale([200.0, 60.0, 200.0]),
        },
        "sun": {"type": "directional", "direction": (-sun.direction).tolist(), "irradiance": grey(1.0)},
        "sensor": {
            "type": "perspective", "fov": _FOV_DEG, "medium": {"type": "ref", "id": "water"},
            "to_world": transform().look_at(origin=[0, 0, 0], target=target.tolist(), up=[0, 1, 0]),
            "sampler": {"type": "independent", "sample_count": _SAMPLES},
            "film": {
                "type": "hdrfilm", "width": _PIXELS, "height": _PIXELS, "rfilter": {"type": "box"},
                "pixel_format": "luminance", "component_format": "float32",
            },
        },
    }  # fmt: skip
    if ball:
        scene["ball"] = {
            "type": "sphere", "center": BALL.centre.tolist(), "radius": BALL.radius,
            "bsdf": {"type": "diffuse", "reflectance": grey(0.0)},
        }  # fmt: skip
    return np.asarray(mi.render(mi.load_dict(scene), spp=_SAMPLES, seed=seed)).reshape(_PIXELS, _PIXELS)


def _window(target: np.ndarray, fine: int) -> np.ndarray:
    """Return directions (n fine, n fine, 3) of the path tracer's pixels, `fine` times finer."""
    forward = unit(target)
    right = unit(np.cross(forward, [0.0, 1.0, 0.0]))
    upward = np.cross(right, forward)
    at = np.tan(np.radians(0.5 * _FOV_DEG)) * (2.0 * (np.arange(_PIXELS * fine) + 0.5) / (_PIXELS * fine) - 1.0)
    return unit(forward + at[None, :, None] * right - at[:, None, None] * upward)


def _ours(a: float, b: float, p: np.ndarray, sun: Sun, directions: np.ndarray, steps: int = 2048) -> np.ndarray:
    """Return smooth light and what the ball takes from it (2, m) for a beam of unit irradiance at the surface."""
    c, up = a + b, sun.direction[1]
    ends = np.where(directions[:, 1] > 0.0, DEPTH_M / np.maximum(directions[:, 1], 1e-9), 80.0)
    ends = np.minimum(ends, BALL.distance(np.zeros_like(directions), directions))
    rate = c * (1.0 - directions[:, 1] / up)
    edge = ends[:, None] * np.linspace(0.0, 1.0, steps + 1) ** 2
    light = exponential_integral(rate[:, None], edge[:, :-1], edge[:, 1:])
    point = (0.5 * (edge[:, :-1] + edge[:, 1:]))[..., None] * directions[:, None]
    shaded = BALL.occluded(point.reshape(-1, 3), np.broadcast_to(sun.direction, (point.size // 3, 3)))
    factor = b * p * np.exp(-c * DEPTH_M / up)
    return factor * np.array([light.sum(-1), (light * shaded.reshape(light.shape)).sum(-1)])


def section_truth() -> None:
    """Contrast of the shaft of a ball: 1 - radiance with it/radiance without it, in its core."""
    from mr360uw.medium.phase import henyey_greenstein

    print("once: contrast by Mitsuba and ours, target 5 %. all: what the ball takes by wide angles (p', c'), by exact")
    print("single scattering (p, c), and by Mitsuba with all orders of scattering; ratios to the last")
    for name, (a, b, g) in WATERS.items():
        for elevation, below in ((75.0, 1.5), (50.0, 1.5)):
            sun = sun_at(elevation)
            target = BALL.centre - below * sun.direction
            fine = _window(target, 3).reshape(-1, 3)
            cosine = fine @ sun.direction
            p = henyey_greenstein(cosine, g)
            smooth, taken = (_mean(x) for x in _ours(a, b, p, sun, fine))
            seen = _mean(np.isinf(BALL.distance(np.zeros_like(fine), fine)).astype(np.float64)) == 1.0
            core = seen & (taken / smooth > 0.7 * np.max((taken / smooth)[seen]))
            once = [path_traced(a, b, g, sun, target, ball, 2)[core].mean() for ball in (False, True)]
            contrast, ours = 1.0 - once[1] / once[0], (taken[core].sum() / smooth[core].sum())
            line = f"{name:5} sun {elevation:.0f}: once {contrast:.4f} {ours:.4f} ({ours / contrast - 1.0:+.1%})"
            if g:
                phase = ("hg", g)
                share = float(wide_angle_moments(phase, 1)[0])
                wide = wide_angle_function(phase, np.arccos(np.clip(cosine, -1.0, 1.0)))
                beam = _mean(_ours(a, b * share, wide / share, sun, fine)[1])[core].mean()
                pairs = [
                    [path_traced(a, b, g, sun, target, ball, 48, seed)[core] for ball in (0, 1)] for seed in _SEEDS
                ]
                lost = [float(np.mean(x - y)) for x, y in pairs]
                mean, error = np.mean(lost), np.std(lost, ddof=1) / np.sqrt(len(lost))
                line += f"  all: {beam:.2e} {taken[core].mean():.2e} of {mean:.2e} +- {error:.0e}"
                line += f" = {beam / mean:.2f}, {taken[core].mean() / mean:.2f}"
            print(line, flush=True)


_SEEDS = range(6)


def _mean(x: np.ndarray) -> np.ndarray:
    fine = round(np.sqrt(x.size)) // _PIXELS
    return x.reshape(_PIXELS, fine, _PIXELS, fine).mean(axis=(1, 3))


# --- grid ----------------------------------------------------------------------------------------------------------


def waves(sun: Sun, medium: Medium, time_s: float = 0.0, method: str = "exact") -> CausticStack:
    """Return the caustics of the default sea down to 25 m."""
    sea = GerstnerSea(wind_speed=4.0, wind_direction_deg=30.0, tile_m=8.0, seed=1)
    settings = CausticSettings(size=256, grid=128, method=method)
    depths = stack_depths(0.2, 25.0, 24)
    return caustic_stack(sea, refract_to_air(sun.direction), depths, time_s, settings, spread=spread_of(medium))


def water(name: str) -> Medium:
    """Return the water of a type, with eight fitted bands: the bands cost nothing on the grid, but in the truth."""
    return Medium(Water.jerlov(name), camera_depth_m=DEPTH_M, band_count=8, rule="fitted")  # type: ignore[arg-type]


VIEW = View(64, 32, surface_y_m=DEPTH_M)
PAIR = (BALL, Ball(np.array([1.6, -0.3, -1.4]), 0.4))
TORCH = Lamp(
    np.array([0.45, -0.2, 0.0]), unit([-0.1, 0.05, -1.0]), np.ones(3), cos_core=float(np.cos(np.radians(12.0))),
    cos_edge=float(np.cos(np.radians(20.0))), radius_m=0.02,
)  # fmt: skip


def scenes() -> dict[str, ShaftScene]:
    """Return the six scenes."""
    described: dict[str, tuple[str, float, bool, tuple[Ball, ...]]] = {
        "IA, high sun, waves": ("IA", 75.0, True, ()),
        "IB, low sun, waves": ("IB", 48.0, True, ()),
        "II, high sun, waves, two balls": ("II", 75.0, True, PAIR),
        "3C, low sun, two balls": ("3C", 48.0, False, PAIR),
        "7C, high sun, waves": ("7C", 75.0, True, ()),
    }
    found = {}
    for name, (type_, elevation, wavy, bodies) in described.items():
        sun, medium = sun_at(elevation), water(type_)
        found[name] = ShaftScene.of(VIEW, medium, [sun], bodies, waves(sun, medium) if wavy else None)
    found["IB, torch, two balls"] = ShaftScene.of(VIEW, water("IB"), [TORCH], PAIR)
    return found


GRIDS = (FroxelGrid(96, 256, 32), FroxelGrid(192, 512, 32), DEFAULT_GRID)
_RAYS, _STEPS = 384, 4096


def section_grid() -> None:
    """Error of the grid over the rms of the deviation, rays spread evenly over the sphere, and its processor time."""
    rng = np.random.default_rng(5)
    directions = unit(rng.normal(size=(_RAYS, 3)))
    print(f"{'scene':32}" + "".join(f"{g.rows:>6} x {g.columns} x {g.slices}  " for g in GRIDS))
    errors = {}
    everything = scenes()
    for scene in everything.values():
        shaft_field(scene, GRIDS[0], directions[:9])  # compiles and reads in what is compiled
    for name, scene in everything.items():
        ends = ray_ends(scene, directions)
        truth = march(scene, directions, ends, _STEPS)
        cells, errors[name] = "", []
        for grid in GRIDS:
            start = time.process_time()
            field = shaft_field(scene, grid)
            spent = time.process_time() - start
            error = rms(field.radiance(directions, ends) - truth) / rms(truth)
            errors[name].append((spent, error))
            cells += f"{100.0 * error:12.2f} % {spent:5.1f} s"
        print(f"{name:32}{cells}", flush=True)
    print(f"target: 3 % at the default grid {DEFAULT_GRID}")


def ray_ends(scene: ShaftScene, directions: np.ndarray) -> np.ndarray:
    """Return the lengths of rays up to the surface or the first body."""
    hits = scene.bodies.first_hit_m(scene.origin, directions)
    return np.minimum(hits, np.where(directions[:, 1] > 0.0, scene.depth_m / np.maximum(directions[:, 1], 1e-9), 1e9))


# --- bands ---------------------------------------------------------------------------------------------------------


def averaged(water: ShaftWater) -> ShaftWater:
    """Return three bands instead: albedo and mean free path weighted by each channel's sensitivity (Monzon 2022)."""
    length, whole = water.weight.T @ (1.0 / water.extinction), water.weight.T @ (1.0 / water.attenuation)
    molecules, particles = (
        water.weight.T @ (b / water.extinction) / length for b in (water.molecules, water.particles)
    )
    return replace(
        water, extinction=1.0 / length, attenuation=1.0 / whole, molecules=molecules, particles=particles,
        weight=np.eye(3),
    )  # fmt: skip


def section_bands() -> None:
    """Three bands of averaged albedo and mean free path against all wavelengths, per channel."""
    for type_ in ("IA", "IB", "II", "1C", "3C", "7C"):
        sun, medium = sun_at(60.0), Medium(Water.jerlov(type_), camera_depth_m=DEPTH_M)  # type: ignore[arg-type]
        scene = ShaftScene.of(VIEW, medium, [sun], PAIR)
        directions = view_directions(VIEW)
        ends = ray_ends_m(VIEW, directions, DEPTH_M, scene.bodies, None)
        cheap = replace(scene, water=averaged(scene.water))
        whole, three = (march(s, directions, ends, 128) for s in (scene, cheap))
        error = np.sqrt(np.mean((three - whole) ** 2, axis=0) / np.mean(whole**2, axis=0))
        ratio = three.sum(axis=0) / whole.sum(axis=0)
        print(f"{type_:3} relative RMSE of red, green, blue: {error.round(3)}  ratio of the means {ratio.round(3)}")


# --- cookie --------------------------------------------------------------------------------------------------------


def section_cookie() -> None:
    """Shafts of the published cookie, the darker of two scrolling copies of one map, against those of moving waves."""
    rng = np.random.default_rng(6)
    directions = unit(rng.normal(size=(2000, 3)))
    print("rms of the deviation over that of moving waves; correlation with 0.04, 0.2 and 1 s later; mean of eight")
    print("seconds over the rms (0.35 if they are independent)")
    for type_, elevation in (("IB", 75.0), ("II", 48.0)):
        sun, medium = sun_at(elevation), water(type_)
        found = {}
        for method in ("exact", "scrolling"):
            seen = {}
            for time_s in (0.0, 0.04, 0.2, *np.arange(1.0, 8.0)):
                scene = ShaftScene.of(VIEW, medium, [sun], (), waves(sun, medium, float(time_s), method))
                ends = ray_ends(scene, directions)
                seen[time_s] = shaft_field(scene, DEFAULT_GRID, directions).radiance(directions, ends)[:, 1]
            found[method] = seen
        for method, seen in found.items():
            later = [float(np.corrcoef(seen[0.0], seen[t])[0, 1]) for t in (0.04, 0.2, 1.0)]
            mean = np.mean([seen[t] for t in (0.0, *np.arange(1.0, 8.0))], axis=0)
            size = rms(seen[0.0]) / rms(found["exact"][0.0])
            print(
                f"{type_} {method:10} {size:5.2f}  {np.round(later, 2)}  {rms(mean) / rms(seen[0.0]):.2f}", flush=True
            )


# --- cost ----------------------------------------------------------------------------------------------------------

_FRAMES, WIDTHS = 12, (2048, 3840)
_SWIMS = "object.0.key=[{time_s=0, position_m=[0.4, -0.6, -3.6]}, {time_s=1, position_m=[1.4, -0.4, -3.2]}]"


def section_cost() -> None:
    """Processor time of the layer of a dive's frame without and with shafts, medians; target 1.6 times."""
    for width in WIDTHS:
        with tempfile.TemporaryDirectory() as folder:
            path = sample_dive(Path(folder) / "dive", width=width, frames=_FRAMES).scene
            for kind, keys in (("still", []), ("moving", [_SWIMS])):
                off, on = (layer_ms(load_scene(path, [*keys, f"shafts.mode={mode}"])) for mode in ("off", "auto"))
                print(f"{width:5} {kind:7} off {off:6.0f} ms  on {on:6.0f} ms  {on / off:5.2f}", flush=True)


def layer_ms(scene: Scene) -> float:
    """Return the median processor time [ms] of the layer, caustics included, over a clip's frames after the second."""
    backend, spent, cache = make_backend("gl")[0], [], Cache()
    with open_plate(scene) as video:
        loaded = load(scene, video.width, video.height)
        analysis = clip_analysis(loaded, video, None)
        for frame in video.frames(0, _FRAMES):
            light = plate_light(loaded, analysis, frame, cache)
            start = time.process_time()
            draw_frame(backend, frame_shots(loaded, analysis, backend, frame, 0.0, cache, light), cache)
            spent.append(1e3 * (time.process_time() - start))
    return float(np.median(spent[2:]))


# --- pictures ------------------------------------------------------------------------------------------------------


SECTIONS: dict[str, Callable[[], None]] = {
    "truth": section_truth,
    "grid": section_grid,
    "bands": section_bands,
    "cookie": section_cookie,
    "cost": section_cost,
}

if __name__ == "__main__":
    for name in sys.argv[1:] or SECTIONS:
        print(f"\n{name}: {SECTIONS[name].__doc__}")
        if name != "truth" or has_mitsuba():
            SECTIONS[name]()
