# SPDX-License-Identifier: Apache-2.0
"""How right pictures through the sea surface are: python benchmarks/surface.py [section ...], all without any.

flat: Snell's window, apparent depth, Fresnel's equations, energy, round trips and reciprocity at a level surface.
mitsuba: a Gerstner sea under a sky without a sun from below and from above, against a path tracer on a mesh of the same
surface (needs mitsuba). glitter: slope statistics of the rendered glitter against Cox & Munk 1954. sky: the pattern of
an even sky on the floor against exact rays, and its time.
footprint: few pixels against many. stress: cameras at the surface, waves that bare the floor, low suns, night, calm.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.peers.mitsuba_scene import has_mitsuba, mitsuba  # noqa: E402
from mr360uw import surface  # noqa: E402
from mr360uw.base import optics  # noqa: E402
from mr360uw.base.sphere import direction_from_angles, directions, unit  # noqa: E402
from mr360uw.caustics import GerstnerSea  # noqa: E402
from mr360uw.caustics.sea import mean_square_slope  # noqa: E402
from mr360uw.medium import Water  # noqa: E402
from mr360uw.surface.intersection import first_hits  # noqa: E402
from mr360uw.surface.sampled_sea import SampledSea  # noqa: E402
from mr360uw.surface.sky import Dome  # noqa: E402
from mr360uw.surface.water_light import sky_pattern  # noqa: E402
from mr360uw.types import Sun, View  # noqa: E402

N = 1.34
CALM = GerstnerSea.from_waves([[2.0 * np.pi / 8.0, 0.0]], 0.0, 0.0, 0.0, tile_m=8.0)
UPWARDS = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation (3, 3) of a camera that looks straight up; its transpose looks down."""


def sky(rows: int = 64) -> np.ndarray:
    """Return a sky (rows, 2 rows, 3) that is brighter overhead and to one side, without a sun."""
    d = directions(2 * rows, rows)
    bright = 1.0 + 1.5 * np.maximum(d[..., 1], 0.0) + 0.5 * d[..., 0] * np.maximum(d[..., 1], 0.0)
    return bright[..., None] * np.array([0.8, 1.0, 1.25])


def sun_at(elevation_deg: float, azimuth_deg: float = 0.0, irradiance: float = 5.0) -> Sun:
    """Return a sun in the air."""
    direction = direction_from_angles(np.radians(azimuth_deg), np.radians(elevation_deg))
    return Sun(direction, np.full(3, irradiance), 0.00465, 1.0)


def say(name: str, value: float, target: float, unit_: str = "", *, least: bool = False) -> None:
    """Print a figure, its target and whether it is met."""
    met = value >= target if least else value <= target
    print(
        f"  {name}: {value:.4g} {unit_} ({'at least' if least else 'at most'} {target:g}: {'met' if met else 'MISSED'})"
    )


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """Return 20 log10 of the brightest value of `b` over the root mean square difference."""
    return float(20.0 * np.log10(b.max() / np.sqrt(np.mean((a - b) ** 2))))


def flat() -> None:
    """A level surface against closed forms."""
    print("flat")
    view = View(512, 512, np.zeros(3), UPWARDS, 4.0, "perspective", fov_rad=np.radians(110.0))
    dark = np.zeros((16, 32, 3))
    dark[:8] = 1.0
    seen = surface.picture(CALM, dark, (-2.0, 0.0), view, samples=4).radiance[..., 1]
    edge = np.arcsin(1.0 / N)
    # light falls to zero at the edge itself, so a pixel with any light is inside
    across = np.flatnonzero(seen[255] > 1e-6)
    inside = 0.5 * (across[-1] - across[0] + 1)
    say("edge of Snell's window", abs(inside - np.tan(edge) * 512.0 / (2.0 * np.tan(np.radians(55.0)))), 1.0, "pixels")
    apparent_depth()
    c = np.linspace(1e-3, 1.0 - 1e-3, 2001)
    across_, along = optics.fresnel_polarized(c, N)
    ti, tt = np.arccos(c), np.arcsin(np.sqrt(1.0 - c * c) / N)
    error = max(
        np.abs(across_ - (np.sin(ti - tt) / np.sin(ti + tt)) ** 2).max(),
        np.abs(along - (np.tan(ti - tt) / np.tan(ti + tt)) ** 2).max(),
    )
    say("Fresnel against sines and tangents", float(error), 1e-6)
    energy()
    d = unit(np.random.default_rng(1).standard_normal((100_000, 3)) * [1, 0, 1] + [0.0, 1.0, 0.0])
    back = optics.refract_to_air(optics.refract_to_water(d, N), N)
    say("round trip air to water to air", float(np.abs(back - d).max()), 1e-12)
    behind = optics.cosine_behind(c, N)
    there, home = optics.radiance_factor(c, N) / N**2, optics.radiance_factor(behind, 1.0 / N) * N**2
    say("reciprocity", float(np.abs(there - home).max()), 1e-12)


def apparent_depth() -> None:
    """The depth at which a chequer on the floor seems to lie, by the pixels of its edges."""
    depth, high = 3.0, 10.0
    size, fov = 2048, np.radians(40.0)
    view = View(size, size, np.array([0.0, high, 0.0]), UPWARDS.T, 0.0, "perspective", fov_rad=fov)
    chequer = np.zeros((512, 512))
    chequer[:, :256] = 0.8
    floor = surface.Floor(-depth, chequer, 1.0)
    band = View(size, 3, view.position, view.world_from_camera, 0.0, "perspective", fov_rad=fov)
    row = surface.picture(CALM, np.ones((8, 16, 3)), floor, band, samples=4).radiance[1, :, 1]
    level = 0.5 * (row.max() + row.min())
    crossing = np.flatnonzero((row[:-1] - level) * (row[1:] - level) < 0.0)
    crossing = crossing[(crossing > 5) & (crossing < size - 7)]
    near = crossing[:, None] + np.arange(-4, 6)  # the light of the left side, in pixels from there on
    left, right = row[crossing - 5][:, None], row[crossing + 6][:, None]
    at = crossing - 4 + np.sum((row[near] - right) / (left - right), axis=1)
    tangent = np.abs((2.0 * at / size - 1.0) * np.tan(0.5 * fov))
    # where Snell's law puts the edges x = k/2: the angle in air that reaches them
    worst = 0.0
    for t in tangent[tangent > 0.05]:
        sine = t / np.hypot(1.0, t)
        wet = sine / N / np.sqrt(1.0 - (sine / N) ** 2)
        x = high * t + depth * wet
        edge = 0.5 * np.round(x / 0.5)
        seen = (edge - high * t) / wet
        worst = max(worst, abs(seen / depth - 1.0))
    say("apparent depth, relative", worst, 0.002)


def energy() -> None:
    """Flux of uniform light on both sides of a level surface: what passes, over the directions behind it, and what is
    reflected, against what comes in."""
    x, w = np.polynomial.legendre.leggauss(400)
    u, du = 0.5 * (1.0 + x), 0.5 * w
    critical = optics.critical_cosine(N)
    # cosines that start at the edge of Snell's window with a square, where reflectances are like a root
    window, dwindow = critical + (1.0 - critical) * u**2, (1.0 - critical) * 2.0 * u * du
    down = np.sum(window * dwindow * (1.0 - optics.fresnel_from_below(window, N)) * N**2)
    back = np.sum(u * du * optics.fresnel(u, N))
    say("energy down and reflected over incoming", float(abs((down + back) / 0.5 - 1.0)), 1e-6)
    up = np.sum(u * du * optics.radiance_factor(optics.cosine_behind(u, N), 1.0 / N))
    home = 0.5 * optics.diffuse_reflectance_from_below(N)
    say("energy up and reflected over incoming", float(abs((up + home) / 0.5 - 1.0)), 1e-6)


SEA = GerstnerSea.from_waves(
    2.0 * np.pi / 8.0 * np.array([[2, 1], [-1, 3], [4, -2], [3, 4]]),
    [0.05, 0.04, 0.02, 0.015], [0.8, 0.7, 0.6, 0.5], [0.3, 1.9, 4.0, 5.5], tile_m=8.0,
)  # fmt: skip
FLOOR_M, ALBEDO = 3.0, 0.3
_R = np.sqrt(0.5)
DOWN_45 = np.array([[1.0, 0.0, 0.0], [0.0, _R, _R], [0.0, -_R, _R]])
CAMERAS = {
    "below": View(192, 192, np.array([0.3, -2.0, 0.2]), UPWARDS, 0.0, "perspective", fov_rad=np.radians(110.0)),
    "above": View(48, 48, np.array([0.3, 5.0, 0.2]), DOWN_45, 0.0, "perspective", fov_rad=np.radians(50.0)),
}
PATHS = {"below": 64, "above": 2048}
"""Paths for each pixel: seen from above all light of the floor has come through waves by chance, which is noisy."""


def water_mesh(mi: Any, tiles: int, size: int) -> Any:
    """Return the sea's surface as a dielectric mesh of `tiles` by `tiles` tiles with its exact normals."""
    at = (np.arange(tiles * size + 1) / size - 0.5 * tiles) * SEA.tile_m
    x, z = np.meshgrid(at, at)
    s = SEA.surface(x, z, 0.0)
    n = len(at)
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]
    faces = np.stack([np.stack([a, d, c], -1), np.stack([a, c, b], -1)], axis=2).reshape(-1, 3)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "dielectric", "int_ior": N, "ext_ior": 1.0})
    mesh = mi.Mesh("sea", n * n, len(faces), has_vertex_normals=True, props=properties)
    values = mi.traverse(mesh)
    values["vertex_positions"] = s.position.astype(np.float32).ravel()
    values["vertex_normals"] = s.normal.astype(np.float32).ravel()
    values["faces"] = faces.astype(np.uint32).ravel()
    values.update()
    return mesh


def traced(view: View, samples: int) -> np.ndarray:
    """Return the path tracer's picture (H, W, 3)."""
    mi = mitsuba()
    transform = mi.ScalarTransform4f
    dome = sky(128)
    image = np.roll(dome, dome.shape[1] // 2, axis=1).astype(np.float32)
    forward, up = -view.world_from_camera[:, 2], view.world_from_camera[:, 1]
    scene = mi.load_dict({
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 24, "rr_depth": 12},
        "sky": {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(image))},
        "sea": water_mesh(mi, 13, 160),
        "floor": {
            "type": "rectangle",
            "to_world": transform().translate([0.0, -FLOOR_M, 0.0]).rotate([1, 0, 0], -90).scale(52.0),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [ALBEDO] * 3}},
        },
        "sensor": {
            "type": "perspective", "fov": float(np.degrees(view.fov_rad)), "fov_axis": "x",
            "film": {"type": "hdrfilm", "width": view.width, "height": view.height, "rfilter": {"type": "box"},
                     "component_format": "float32"},
            "sampler": {"type": "independent", "sample_count": samples},
            "to_world": transform().look_at(
                origin=view.position.tolist(), target=(view.position + forward).tolist(), up=up.tolist()
            ),
        },
    })  # fmt: skip
    return np.array(mi.render(scene, spp=samples))[..., :3].astype(np.float64)


def path_tracer() -> None:
    """Both cameras against the path tracer."""
    print("mitsuba")
    for name, view in CAMERAS.items():
        began = time.perf_counter()
        truth = traced(view, PATHS[name])
        took = time.perf_counter() - began
        began = time.perf_counter()
        mine = surface.picture(SEA, sky(128), (-FLOOR_M, ALBEDO), view, samples=4, refractive_index=N)
        print(f"  {name}: path tracer {took:.0f} s, picture {time.perf_counter() - began:.0f} s; mean over truth "
              f"{mine.radiance.mean() / truth.mean():.4f}")  # fmt: skip
        say(f"{name}: PSNR", psnr(mine.radiance, truth), 36.0, "dB", least=True)
        print(f"  {name}: PSNR of means of 4 x 4 pixels, with less of its noise: "
              f"{psnr(coarse(mine.radiance), coarse(truth)):.1f} dB")  # fmt: skip
        if name == "below":
            say("edge of Snell's window, median", window_edge(mine.radiance, truth), 1.0, "pixels")


def coarse(image: np.ndarray, by: int = 4) -> np.ndarray:
    """Return means over squares of pixels."""
    h, w = image.shape[0] // by, image.shape[1] // by
    return image.reshape(h, by, w, by, 3).mean(axis=(1, 3))


def window_edge(mine: np.ndarray, truth: np.ndarray) -> float:
    """Return the median distance [pixels] between the outermost places of both where rows cross half of the window."""
    level = 0.5 * (np.percentile(truth[..., 1], 95) + np.percentile(truth[..., 1], 5))
    apart = []
    for a, b in zip(mine[..., 1], truth[..., 1], strict=True):
        ia, ib = np.flatnonzero(a > level), np.flatnonzero(b > level)
        if len(ia) and len(ib):
            apart += [abs(ia[0] - ib[0]), abs(ia[-1] - ib[-1])]
    return float(np.median(apart))


def glitter() -> None:
    """Slope variance from glitter as Cox & Munk took it from photographs: p(s) = 4 L cos(view) n_y^4/(F E)."""
    print("glitter")
    sun = sun_at(90.0)
    black = np.zeros((8, 16, 3))
    for height in (12.0, 80.0):
        view = View(384, 192, np.array([0.0, height, 0.0]), surface_y_m=0.0)
        d = directions(384, 192)
        normal = unit(sun.direction - d + 1e-12)
        cosine, slope = -np.sum(d * normal, axis=-1), np.hypot(normal[..., 0], normal[..., 2]) / normal[..., 1]
        per_slope = np.cos(np.arcsin(d[..., 1])) / np.maximum(4.0 * cosine * normal[..., 1] ** 3, 1e-12)
        used = d[..., 1] < -np.sin(np.radians(15.0))
        for wind in (3.0, 6.0, 10.0):
            sea = GerstnerSea(wind_speed=wind, tile_m=16.0)
            light = surface.picture(sea, black, (-30.0, 0.0), view, sun=sun, samples=3).radiance[..., 1]
            p = 4.0 * light * -d[..., 1] * normal[..., 1] ** 4 / (optics.fresnel(cosine, N) * sun.irradiance[1])
            share = (p * per_slope)[used]
            found = np.sum(share * slope[used] ** 2) / np.sum(share)
            off = abs(found / mean_square_slope(wind) - 1.0)
            say(f"{wind:g} m/s from {height:g} m: {found:.4f} of {mean_square_slope(wind):.4f}, off", off, 0.15)


def sky_on_floor() -> None:
    """Contrast under two waves at random places, by 4000 exact rays each, and its processor time."""
    depth, count, place = 5.0, 4000, np.random.default_rng(3).uniform(0.0, 8.0, (96, 2))
    sea = GerstnerSea.from_waves([[np.pi / 2.0, 0.0], [0.0, np.pi]], [0.06, 0.03], 0.8, 0.5, tile_m=8.0)
    sine, turn = np.sqrt((np.arange(count) + 0.5) / count), np.arange(count) * (np.pi * (3.0 - np.sqrt(5.0)))
    up = np.stack([sine * np.cos(turn), np.sqrt(1.0 - sine**2), sine * np.sin(turn)], axis=-1)
    sampled, none, truth = SampledSea.of(sea, 0.7), np.zeros(count), []
    for x, z in place:
        origin = np.tile([x, -depth, z], (count, 1))
        hits = first_hits(sampled, origin, up, True, none, none, np.full(count, 1e6))
        truth.append(np.mean(1.0 - optics.fresnel_from_below(np.sum(up * hits.normal, axis=1), N)))
    dome = Dome(np.ones((32, 64, 3)))
    sky_pattern(sea, sampled, dome, depth, 0.7, N)
    start = time.process_time()
    pattern = sky_pattern(sea, sampled, dome, depth, 0.7, N)
    took = time.process_time() - start
    found = pattern.at(place[:, 0], place[:, 1], np.zeros(len(place)))[:, 1]
    mine, exact = found / found.mean(), np.array(truth) / np.mean(truth)
    print(
        f"contrast of the sky on the floor: {mine.std():.4f}, exact rays {exact.std():.4f}; {took:.2f} s of processor"
    )
    say("error over the light, rms", float(np.sqrt(np.mean((mine - exact) ** 2))), 0.004)


def footprint() -> None:
    """Pictures of few pixels against the means of pictures of sixteen times as many, nine rays in each."""
    print("footprint")
    sea = GerstnerSea(wind_speed=5.0)
    for name, y in {"below": -1.5, "above": 3.0}.items():
        few, many = (View(64 * k, 32 * k, np.array([0.0, y, 0.0]), surface_y_m=0.0) for k in (1, 4))
        a = surface.picture(sea, sky(), (-6.0, 0.35), few, samples=2).radiance
        b = coarse(surface.picture(sea, sky(), (-6.0, 0.35), many, samples=3).radiance)
        print(f"  {name}: mean {a.mean() / b.mean():.4f} of theirs, PSNR {psnr(a, b):.1f} dB")


def stress() -> None:
    """Unusual cameras, seas and suns: light that is finite and nowhere negative."""
    print("stress")
    low = {"samples": 2}
    at = lambda y, x=0.3: View(64, 32, np.array([x, y, 0.2]), surface_y_m=0.0)  # noqa: E731
    high = GerstnerSea.from_waves([[2.0 * np.pi / 8.0, 0.0]], 1.0, 0.9, 0.3, tile_m=8.0)
    crest = float(surface.SampledSea.of(SEA, 0.0).heights([0.3], [0.2])[0])
    cases: dict[str, tuple[Any, ...]] = {
        "a millimetre under the waves": (SEA, sky(), (-3.0, 0.3), at(crest - 1e-3), None, sun_at(40.0)),
        "a millimetre over the waves": (SEA, sky(), (-3.0, 0.3), at(crest + 1e-3), None, sun_at(40.0)),
        "waves taller than the depth, from above": (high, sky(), (-0.4, 0.3), at(5.0), None, sun_at(40.0)),
        "waves taller than the depth, from below": (high, sky(), (-0.4, 0.3), at(-0.3, 1.5), None, sun_at(40.0)),
        "sun at the horizon, below": (SEA, sky(), (-3.0, 0.3), at(-1.0), Water.jerlov("IB"), sun_at(0.3)),
        "sun at the horizon, above": (SEA, sky(), (-3.0, 0.3), at(5.0), None, sun_at(0.3)),
        "sun below the horizon": (SEA, sky(), (-3.0, 0.3), at(-1.0), Water.jerlov("IB"), sun_at(-5.0)),
        "night": (SEA, np.zeros((8, 16, 3)), (-3.0, 0.3), at(-1.0), Water.jerlov("II"), None),
        "no wind": (GerstnerSea(wind_speed=0.0), sky(), (-3.0, 0.3), at(-1.0), None, sun_at(40.0)),
        "gale": (GerstnerSea(wind_speed=20.0, steepness=1.0), sky(), (-3.0, 0.3), at(-1.0), None, sun_at(40.0)),
        "tile of 5 cm": (GerstnerSea(tile_m=0.05), sky(), (-3.0, 0.3), at(5.0), None, sun_at(40.0)),
        "tile of 2 km": (GerstnerSea(tile_m=2000.0), sky(), (-3.0, 0.3), at(5.0), None, sun_at(40.0)),
        "300 m down": (SEA, sky(), (-400.0, 0.3), at(-300.0), Water.jerlov("III"), sun_at(40.0)),
    }
    for name, (sea, dome, floor, view, water, sun) in cases.items():
        began = time.perf_counter()
        seen = surface.picture(sea, dome, floor, view, water, sun=sun, **low)
        light = seen.radiance
        fine = np.all(np.isfinite(light)) and light.min() >= 0.0 and light.max() < 1e6
        side, took = "in water" if seen.camera_in_water else "in air", time.perf_counter() - began
        print(f"  {name}: {'fine' if fine else 'WRONG'}, {light.min():.3g} to {light.max():.3g}, ", end="")
        print(f"mean {light.mean():.3g}, {side}, {took:.1f} s")


SECTIONS: dict[str, Callable[[], None]] = {
    "flat": flat, "mitsuba": path_tracer, "glitter": glitter, "sky": sky_on_floor, "footprint": footprint,
    "stress": stress,
}  # fmt: skip


def main() -> None:
    """Run the sections that are named."""
    for name in sys.argv[1:] or list(SECTIONS):
        if name != "mitsuba" or has_mitsuba():
            SECTIONS[name]()


if __name__ == "__main__":
    main()
