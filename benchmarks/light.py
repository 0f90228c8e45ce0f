# SPDX-License-Identifier: Apache-2.0
"""How good the light from a plate is, on real maps: python benchmarks/light.py [section] [count]

Sections: irradiance, sun (count = rotations of each map, default 200), expansion, track, time, stress; default: all.
The maps are those of ../shared/data/footage; without them only track, time and stress run.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np

import mr360uw.ibl as ibl
from mr360uw.base.color import LUMINANCE, ColorSpec, decode, encode, luminance, ycbcr_from_rgb
from mr360uw.base.progress import one_blas_thread
from mr360uw.base.sphere import (
    direction_from_angles,
    direction_from_frame,
    directions,
    frame_from_direction,
    row_solid_angle,
    unit,
)
from mr360uw.errors import Mr360uwError
from mr360uw.ibl.filters import ggx_kernel
from mr360uw.ibl.lookup import reduce_map
from mr360uw.ibl.plate import COARSE_COLUMNS, COARSE_ROWS, LinearPlate, remap
from mr360uw.ibl.settings import GLOSSY_ROUGHNESS, LightSettings, Operator
from mr360uw.ibl.sun.detect import find_disc
from mr360uw.ibl.sun.split import sky_irradiance
from mr360uw.types import Sun, YuvImage

FOOTAGE = Path(__file__).resolve().parents[2] / "shared" / "data" / "footage"
SUNNY = ("KernerEnvLatLong.exr", "blender_city_dwab.exr", "polyhaven_sky.hdr", "polyhaven_sunrise.hdr")
SUNLESS = ("StageEnvLatLong.exr", "polyhaven_forest.hdr", "polyhaven_venice.hdr", "OrientationLatLong.exr")
STOPS = (-5, -4, -3)  # exposures under the one that puts the log-mean at 18 %: the sun clips, the sky keeps its tone
BRIGHTER = (-2, -1, 0)  # for the record: 1 % to 40 % of the sphere is clipped


def table(head: tuple[str, ...], rows: list[tuple[Any, ...]]) -> None:
    """Print a table."""
    cells = [head, *((f"{c:.3g}" if isinstance(c, float) else str(c) for c in row) for row in rows)]
    text = [list(row) for row in cells]
    width = [max(len(row[k]) for row in text) for k in range(len(head))]
    for row in text:
        print("  " + "  ".join(cell.ljust(w) for cell, w in zip(row, width, strict=True)).rstrip())
    print()


@cache
def hdr(name: str) -> np.ndarray:
    """Return a map as linear floats, negative samples of lossy codecs at 0."""
    path = FOOTAGE / "hdr" / name
    if path.suffix == ".exr":
        import OpenEXR

        with OpenEXR.File(str(path)) as file:
            channels = file.channels()
            key = next(k for k in ("RGB", "RGBA", "R") if k in channels)
            pixels = channels[key].pixels[..., :3] if key != "R" else np.stack([channels[c].pixels for c in "RGB"], -1)
    else:
        pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1]
    return np.maximum(np.asarray(pixels, np.float32), 0.0)


def picture(name: str) -> np.ndarray:
    """Return a display-referred picture as linear floats; of a stereo pair the upper half."""
    path = FOOTAGE / name
    image = cv2.VideoCapture(str(path)).read()[1] if path.suffix == ".mp4" else cv2.imread(str(path))
    if "_tb" in name:
        image = image[: len(image) // 2]
    return decode(image[..., ::-1] / np.float32(255.0), "srgb")


def middle(image: np.ndarray) -> float:
    """Return the factor that puts the log-mean luminance of a map at 18 %."""
    return float(0.18 / np.exp(np.log(np.maximum(image @ LUMINANCE, 1e-4)).mean()))


def clipped(image: np.ndarray, exposure: float) -> np.ndarray:
    """Return a map exposed, clipped and quantised to 8 bit sRGB, as linear floats."""
    code = np.clip(encode(np.minimum(image * np.float32(exposure), 1.0), "srgb"), 0.0, 1.0)
    return decode(np.round(code * 255.0) / np.float32(255.0), "srgb").astype(np.float32)


def test_directions(name: str) -> np.ndarray:
    """Return the 64 x 32 pixels (n,) a map is judged at: 192 at random, and the 64 that face its brightest place."""
    image = hdr(name)
    row, column = np.unravel_index(int(luminance(image).argmax()), image.shape[:2])
    facing = directions(64, 32).reshape(-1, 3) @ directions(*image.shape[1::-1])[row, column]
    chosen = np.random.default_rng(1).choice(2048, 192, replace=False)
    return np.union1d(chosen, np.argsort(facing)[-64:])


def brute_force(name: str, kernel: Callable[[np.ndarray], np.ndarray], *, mean: bool) -> np.ndarray:
    """Return the float64 integral of a whole map against a kernel of the cosine, at `test_directions`."""
    image = hdr(name)
    height, width = image.shape[:2]
    normals = directions(64, 32).reshape(-1, 3)[test_directions(name)]
    d, omega = directions(width, height), row_solid_angle(width, height)
    total, norm = np.zeros((len(normals), 3)), np.zeros((len(normals), 1))
    for j in range(height):
        weight = kernel(normals @ d[j].T) * omega[j]
        total += weight @ image[j].astype(np.float64)
        norm += weight.sum(axis=1, keepdims=True)
    return total / norm if mean else total


@cache
def irradiance_truth(name: str) -> np.ndarray:
    """Return the true irradiance of a map at `test_directions`."""
    return brute_force(name, lambda c: np.maximum(c, 0.0), mean=False)


def off(name: str, got: np.ndarray, truth: np.ndarray) -> float:
    """Return the largest error of a 64 x 32 map in percent of the peak."""
    got = got.reshape(2048, 3)[test_directions(name)]
    return float(100.0 * np.abs(got - truth).max() / truth.max())


def irradiance() -> None:
    """Print the errors of the integrals."""
    print("Irradiance, 64 x 32, against the integral of the full map: largest error, % of the peak (target 0.5)")
    rows = []
    for name in SUNNY + SUNLESS:
        truth = irradiance_truth(name)
        light = ibl.environment(hdr(name), expansion="none")
        small = reduce_map(hdr(name), 64, 32)
        sh9 = ibl.irradiance(reduce_map(hdr(name), COARSE_COLUMNS, COARSE_ROWS), "sh9")
        rows.append((name, *(off(name, got, truth) for got in (light.irradiance, ibl.irradiance(small), sh9))))
    table(("map", "environment()", "irradiance() of 64x32 alone", "SH-9"), rows)

    print("Glossy levels (GGX, n = v = r) of the residual plus the sun's own lobe, % of the peak (target 2)")
    rows = []
    for name in SUNNY + SUNLESS:
        settings = LightSettings(operator="none")
        light = ibl.environment(hdr(name), settings, glossy=True)
        errors = []
        for k, roughness in enumerate(GLOSSY_ROUGHNESS):
            truth = brute_force(name, lambda c, r=roughness: ggx_kernel(c, r), mean=True)
            level = light.glossy[k].astype(np.float64)
            if light.sun is not None:
                level = level + ibl.glossy_beam(light.sun.direction, light.sun.irradiance, roughness)
            errors.append(off(name, level, truth))
        rows.append((name, *errors))
    table(("map", "roughness .2", ".4", ".7"), rows)

    from mr360uw.ibl.filters import split_sum

    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
    from tests.ibl.split_sum import split_sum_integral

    grid = [(r, v) for r in np.linspace(0.05, 1, 12) for v in np.linspace(0.05, 1, 16)]
    exact = np.array([split_sum_integral(r, v) for r, v in grid])
    fit = np.array([split_sum(r, v) for r, v in grid])
    rows = []
    for f0 in (0.02, 0.04, 1.0):
        error = np.abs((fit - exact) @ [f0, 1.0])
        rows.append((f0, float(error.max()), float(np.sqrt((error**2).mean()))))
    print("split_sum against its integral, reflectance of a white sky")
    table(("F0", "largest error", "rms"), rows)


def truth_direction(name: str) -> np.ndarray:
    """Return where the sun of a map is."""
    entry = json.loads((FOOTAGE / "hdr" / "sun_truth.json").read_text("utf-8"))["maps"][name]
    return direction_from_frame(entry["x"], entry["y"], entry["width"], entry["height"])


def rotations(name: str, count: int, seed: int = 360) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield (map turned at random, direction of its sun), the sun above the horizon, every tenth at seam or zenith."""
    from scipy.spatial.transform import Rotation

    rng, sun, image = np.random.default_rng(seed), truth_direction(name), hdr(name)
    height, width = image.shape[:2]
    wanted = directions(width, height)
    for k in range(count):
        while True:
            turn = Rotation.random(random_state=rng)
            if k % 10 < 2:  # to the zenith, or to the seam at a random height
                goal = (
                    np.array([0.0, 1.0, 0.0]) if k % 10 == 0 else direction_from_angles(np.pi, rng.uniform(0.05, 1.5))
                )
                spin = Rotation.from_rotvec(rng.uniform(0, 2 * np.pi) * goal)
                turn = spin * Rotation.align_vectors(goal[None], sun[None])[0]
            place = turn.apply(sun)
            if place[1] > 0.02:
                break
        source = wanted @ turn.as_matrix()
        yield remap(image, *frame_from_direction(source, width, height)), place


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Return the angle between unit vectors in degrees."""
    return float(np.degrees(np.arccos(np.clip(np.dot(a, b), -1.0, 1.0))))


def sun(count: int = 200) -> None:
    """Print the errors of the detector."""
    print(
        f"Sun direction, {count} rotations of each map, HDR and clipped to 8 bit (target: median .3, 95 % within 1 deg)"
    )
    found: dict[str, dict[str, list[float]]] = {}
    for name in SUNNY:
        exposure = middle(hdr(name))
        for image, place in rotations(name, count):
            for label in ("HDR", *STOPS, *BRIGHTER):
                plate = image if label == "HDR" else clipped(image, exposure * 2.0**label)
                found_sun = ibl.detect_sun(plate)
                ok = found_sun is not None and found_sun.confidence >= 0.5
                error = angle(found_sun.direction, place) if found_sun is not None and ok else np.nan
                found.setdefault(str(label), {}).setdefault(name, []).append(error)
    rows, judged = [], []
    for label, maps in found.items():
        for name, errors in maps.items():
            e = np.array(errors)
            seen = e[np.isfinite(e)]
            within = float(100.0 * np.mean(np.nan_to_num(e, nan=99.0) <= 1.0))
            rows.append(
                (label, name, float(np.median(seen)) if seen.size else np.nan, within, 100.0 * len(seen) / len(e))
            )
            if label not in map(str, BRIGHTER):
                judged += list(np.nan_to_num(e, nan=99.0))
    table(("stops", "map", "median deg", "% within 1 deg", "% found"), rows)
    all_errors = np.array(judged)
    median, within = np.median(all_errors), 100.0 * np.mean(all_errors <= 1.0)
    print(f"  HDR and {STOPS} stops: median {median:.2f} deg, {within:.1f} % within 1 deg\n")

    print("Pictures with a sun (tolerance 20 pixels)")
    truths = json.loads((FOOTAGE / "360" / "sun_truth_ldr.json").read_text("utf-8"))["images"]
    rows = []
    for name, entry in truths.items():
        disc = find_disc(LinearPlate(picture(name)))
        place = direction_from_frame(entry["x"], entry["y"], entry["width"], entry["height"])
        pixels = angle(disc.direction, place) / 360.0 * entry["width"] if disc else np.nan
        rows.append((name, pixels, entry["tol_px"], disc.confidence if disc else 0.0))
    table(("picture", "error px", "tolerance", "confidence"), rows)

    print("Maps and pictures without a sun (target: none, or confidence below 0.5, in 9 of 10)")
    negative = {name: hdr(name) for name in SUNLESS}
    pictures = (
        "360/chichen-itza.jpg", "360/machu-picchu.jpg", "360/pannellum_examplepano.jpg",
        "360/gopro_max_stitched_GS018423_1.jpg", "360/congo_forest_stereo_tb.mp4", "360/overpass_mono.mp4",
        "underwater360/catlin_pedras_secas_two_stereo_tb.jpg",
    )  # fmt: skip
    negative |= {name: picture(name) for name in pictures}
    rows = []
    for name, image in negative.items():
        disc = find_disc(LinearPlate(image))
        rows.append((name, disc.confidence if disc else 0.0))
    for name in SUNLESS[:3]:
        for stops in STOPS:
            disc = find_disc(LinearPlate(clipped(hdr(name), middle(hdr(name)) * 2.0**stops)))
            rows.append((f"{name} clipped, {stops} stops", disc.confidence if disc else 0.0))
    table(("map", "confidence"), rows)
    print(f"  rejected: {sum(row[1] < 0.5 for row in rows)} of {len(rows)}\n")


def expansion() -> None:
    """Print the errors of every operator on clipped maps."""
    print(
        "Expansion of clipped maps: irradiance error [%] (mean |difference| over mean) and, in brackets, the error of"
    )
    print("log10 luminance above the clip point (rms). Exposures:", STOPS, "stops. closure: given the map's own ratio.")
    rows, closed = [], {op: [] for op in (*get_args(Operator), "closure, ratio unknown")}
    for name in SUNNY + SUNLESS[:3]:
        truth, image = irradiance_truth(name), hdr(name)
        light = ibl.environment(image, expansion="none")
        ratio = 0.0
        if light.sun is not None:
            sky = sky_irradiance(np.repeat(np.repeat(light.residual, 4, 0), 4, 1))
            ratio = float(luminance(light.sun.irradiance) * light.sun.direction[1] / luminance(sky))
        for stops in STOPS:
            exposure = middle(image) * 2.0**stops
            plate = clipped(image, exposure)
            above = (luminance(plate) > 0.95) & (directions(*image.shape[1::-1])[..., 1] > 0.2)
            cells = []
            for op in closed:
                given = {"direct_to_diffuse": min(ratio, 100.0)} if op == "closure" else {}
                settings = LightSettings(operator=op.split(",")[0], **given)
                light = ibl.environment(plate, settings).irradiance.reshape(2048, 3) / exposure
                got = light[test_directions(name)]
                error = float(100.0 * np.abs(got - truth).sum() / truth.sum())
                closed[op].append(error)
                log = np.log10(luminance(ibl.expand(plate, settings))[above] / exposure / luminance(image)[above])
                cells.append(f"{error:.0f} ({np.sqrt((log**2).mean()) if log.size else 0.0:.2f})")
            rows.append((name, stops, f"{ratio:.2f}", *cells))
    table(("map", "stops", "ratio", *closed), rows)
    table(("median error of irradiance, %", *closed), [("", *(float(np.median(v)) for v in closed.values()))])


def synthetic_clip(
    seed: int, turn_deg: float, frames: int = 600, cut: int = 290, noise_deg: float = 2.0, dropout: float = 0.1
) -> tuple[np.ndarray, list[ibl.SunMeasurement]]:
    """Return (true directions, measurements) of a camera that turns to and fro, with one cut."""
    rng = np.random.default_rng(seed)
    t = np.arange(frames) / 30.0
    second = np.arange(frames) >= cut
    azimuth = np.radians(turn_deg * np.sin(2 * np.pi * t / 18.0) + np.where(second, 50.0, 0.0))
    elevation = np.radians(48.0 + turn_deg / 3.0 * np.sin(2 * np.pi * t / 14.0))
    true = np.stack([direction_from_angles(a, e) for a, e in zip(azimuth, elevation, strict=True)])
    step = rng.normal(size=(frames, 3)) * np.radians(noise_deg) / np.sqrt(2.0)
    seen = unit(true + step - np.sum(step * true, axis=1, keepdims=True) * true)
    light = np.exp(rng.normal(size=(frames, 1)) * 0.2) * np.ones(3)
    lost = rng.random(frames) < dropout
    shots = rng.normal(size=(2, 8, 16))
    pictures = shots[second.astype(int)] + 0.05 * rng.normal(size=(frames, 8, 16))
    suns = [None if lost[k] else Sun(seen[k], light[k], 0.01, 0.9) for k in range(frames)]
    return true, [ibl.SunMeasurement(t[k], suns[k], 1.0, pictures[k]) for k in range(frames)]


def track() -> None:
    """Print the errors of smoothed tracks."""
    print("Track: 600 frames, 2 degrees of noise (rms angle), 10 % dropouts, one cut (target .3 deg rms, no lag)")
    rows = []
    for turn_deg in (0.0, 4.0, 12.0):
        for seed in range(4):
            true, frames = synthetic_clip(seed, turn_deg)
            got = ibl.track_suns(frames)
            alone = ibl.track_suns([frame.sun for frame in frames]).cuts
            error = np.degrees(np.arccos(np.clip(np.sum(got.direction * true, axis=1), -1.0, 1.0)))
            window = slice(20, 270)
            shifts = {
                s: float(np.mean(np.sum(got.direction[window] * np.roll(true, s, 0)[window], 1))) for s in range(-8, 9)
            }
            lag = max(shifts, key=lambda s: shifts[s]) if turn_deg else "-"
            rows.append((turn_deg, seed, float(np.sqrt((error**2).mean())), lag, got.cuts, alone))
    table(("turn deg", "seed", "rms deg", "lag frames", "cut (true: 290)", "from directions alone"), rows)
    print(f"  mean rms {np.mean([row[2] for row in rows]):.2f} deg\n")


def yuv_of(image_encoded: np.ndarray, bits: int = 8) -> YuvImage:
    """Return a picture of code values in [0, 1] as limited range 4:2:0 planes."""
    ycc = image_encoded @ ycbcr_from_rgb("bt709").T
    scale = 1 << (bits - 8)
    height, width = ycc.shape[:2]
    chroma = ycc[..., 1:].reshape(height // 2, 2, width // 2, 2, 2).mean(axis=(1, 3))
    kind = np.uint8 if bits == 8 else np.uint16
    y = np.round((16.0 + 219.0 * ycc[..., 0]) * scale).astype(kind)
    uv = np.round((128.0 + 224.0 * chroma) * scale).astype(kind)
    return YuvImage(y, uv[..., 0].copy(), uv[..., 1].copy(), ColorSpec(bits=bits))


def sample_plate(width: int, height: int) -> np.ndarray:
    """Return a plate in code values with a clipped sun, made here."""
    d = directions(width, height).astype(np.float32)
    s = direction_from_angles(0.7, 0.8).astype(np.float32)
    glow = 0.25 + 0.2 * d[..., 1:2] + 0.5 * np.exp((d @ s - 1.0) * 60.0)[..., None] + 4.0 * (d @ s > 0.9997)[..., None]
    return np.asarray(encode(np.clip(glow * np.array([0.5, 0.9, 1.0], np.float32), 0, 1), "srgb"))


def clock(*calls: Callable[[], Any], repeat: int = 21) -> list[float]:
    """Return the median CPU time of each call in ms, in turns on one thread, so that they meet the same caches."""
    times: list[list[float]] = [[] for _ in calls]
    for k in range(repeat + 1):
        for call, taken in zip(calls, times, strict=True):
            start = time.thread_time()
            call()
            if k:
                taken.append(time.thread_time() - start)
    return [float(1e3 * np.median(taken)) for taken in times]


def time_section() -> None:
    """Print times beside those of a plain resize."""
    print("CPU time of one 4096 x 2048 frame (medians; target: environment and sun in at most 2 x resize)")
    code = sample_plate(4096, 2048)
    rgb = np.round(255.0 * code).astype(np.uint8)
    rows = []
    cv2.setNumThreads(1)
    with one_blas_thread():
        for operator in ("closure", "mr360", "landis"):
            for bits in (8, 10):
                yuv, settings = yuv_of(code, bits), LightSettings(operator=operator)
                base, light = clock(
                    lambda: cv2.resize(rgb, (64, 32), interpolation=cv2.INTER_AREA),
                    lambda y=yuv, s=settings: ibl.environment_from_yuv(y, s),
                )
                rows.append((operator, bits, base, light, light / base))
    cv2.setNumThreads(-1)
    table(("operator", "bits", "resize ms", "environment ms", "ratio"), rows)


def stress() -> None:
    """Print what odd input gives."""
    print("Stress: every input gives finite light or a typed error")
    bright = np.full((64, 128, 3), 0.2, np.float32)
    hot = bright.copy()
    hot[10, 5] = 1e4

    def with_suns(*places: np.ndarray, size: tuple[int, int] = (512, 256)) -> np.ndarray:
        d = directions(*size)
        image = np.full((*d.shape[:2], 1), 0.2)
        for place in places:
            image = image + 2000.0 * (d @ unit(place) > np.cos(0.01))[..., None]
        return np.asarray(image * np.ones(3), np.float32)

    zenith, seam = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.5, 1.0])
    cases = {
        "black": bright * 0, "white": bright * 5, "NaN": bright * np.nan, "negative": -bright, "one hot pixel": hot,
        "16 x 8": bright[:8, :16], "1 x 1": bright[:1, :1], "sun at the zenith": with_suns(zenith),
        "sun at the seam": with_suns(seam), "two suns": with_suns(seam, np.array([1.0, 0.6, -0.2])),
        "sun below the horizon": with_suns(np.array([0.3, -0.5, 0.2])), "700 x 333": with_suns(seam, size=(700, 333)),
        "float64": bright.astype(np.float64), "bytes": (bright * 255).astype(np.uint8), "grey": bright[..., 0],
    }  # fmt: skip
    rows = []
    for name, image in cases.items():
        for operator in ("closure", "mr360", "kovaleski"):
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    light = ibl.environment(image, LightSettings(operator=operator), glossy=True)
                finite = all(np.isfinite(a).all() for a in (light.radiance, light.irradiance, light.glossy))
                state = "no sun" if light.sun is None else f"sun, confidence {light.sun.confidence:.2f}"
                rows.append((name, operator, f"{'finite' if finite else 'NOT FINITE'}, {state}"))
            except Mr360uwError as error:
                rows.append((name, operator, f"{type(error).__name__}: {error}"))
    table(("input", "operator", "result"), rows)


SECTIONS: dict[str, Callable[..., None]] = {
    "irradiance": irradiance, "sun": sun, "expansion": expansion, "track": track, "time": time_section,
    "stress": stress,
}  # fmt: skip


def main(arguments: list[str]) -> int:
    """Run the sections named by the arguments."""
    wanted = arguments[:1] or list(SECTIONS)
    if wanted[0] not in SECTIONS:
        print(f"section - unknown (got {wanted[0]!r}) - take one of {', '.join(SECTIONS)}")
        return 2
    for name in wanted:
        if name in ("irradiance", "sun", "expansion") and not FOOTAGE.is_dir():
            print(f"{name}: needs the maps in {FOOTAGE.name}, which are not beside this checkout; left out\n")
            continue
        SECTIONS[name](*(int(a) for a in arguments[1:2]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
