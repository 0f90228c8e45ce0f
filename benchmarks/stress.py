# SPDX-License-Identifier: Apache-2.0
"""Random scenes on both renderers: python benchmarks/stress.py [FIRST:LAST] [--log FILE] [--backend NAME ...].

Every seed in [FIRST, LAST) (default 0:10000) makes one scene of 128 x 64 pixels: a plate, a mesh or two, and parameters
drawn from the ranges of the scene's schema, its ends included. The composite must be finite and not negative, without
an exception. Scenes that the toolkit refuses with a message are counted apart. With a log, each seed is one line, and
seeds that stand there are not run again. Leaves with 1 if a scene failed.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from mr360uw.caustics.sea.gerstner import GerstnerSea  # noqa: E402
from mr360uw.caustics.sea.spectral import SpectralSea  # noqa: E402
from mr360uw.caustics.settings import CausticSettings  # noqa: E402
from mr360uw.composite.object_settings import ObjectSettings  # noqa: E402
from mr360uw.composite.settings import DrawSettings, LampSettings, ReceiverSettings  # noqa: E402
from mr360uw.compositor import render_frame  # noqa: E402
from mr360uw.errors import Mr360uwError, RenderError  # noqa: E402
from mr360uw.ibl import LightSettings  # noqa: E402
from mr360uw.medium import WaterSettings  # noqa: E402
from mr360uw.sample.whale import write_whale  # noqa: E402
from mr360uw.scene import CameraSettings, Scene, scene_from_dict  # noqa: E402

WIDTH, HEIGHT = 128, 64
SET = 0.3
"""Probability that a parameter is drawn; the others keep their defaults."""
AN_END = 0.15
"""Probability that a number is one of the ends of its range."""
UNBOUNDED = 50.0
"""Numbers without a range are drawn from minus this to this."""
COSTLY = {
    "samples": 13, "sun_samples": 4, "motion_samples": 2, "size": 128, "grid": 64, "planes": 4, "bands": 40,
    "resolution": 64, "wave_count": 32, "scale": 100.0,
}  # fmt: skip
"""Upper ends of parameters that cost time but no care."""
LEFT_OUT = {
    "path", "mesh", "csv", "track", "gravity", "texture", "key", "tilt_keys",
    "depth_keys", "explicit_waves", "eye", "transfer", "illuminant", "sensor", "animation", "object", "model",
    "sun_time", "frame_rate", "invert",
}  # fmt: skip
"""Parameters that name files, or whose values are no numbers and no choices."""
DEEPEST_M, LONGEST_M = 200.0, 60.0


def draw(field: FieldInfo, name: str, rng: np.random.Generator) -> Any:
    """Return a value of a field from its declaration; None where there is nothing to draw."""
    return _of_type(field.annotation, field.metadata, name, rng)


def _of_type(kind: Any, metadata: list[Any], name: str, rng: np.random.Generator) -> Any:
    origin = get_origin(kind)
    if kind is bool:
        return bool(rng.random() < 0.5)
    if kind in (int, float):
        return _number(kind, metadata, name, rng)
    if origin is Literal:
        choices = [c for c in get_args(kind) if not isinstance(c, int) or c <= COSTLY.get(name, c)]
        return choices[rng.integers(len(choices))]
    if origin is tuple and get_args(kind)[-1] is not Ellipsis:
        return tuple(_of_type(part, metadata, name, rng) for part in get_args(kind))
    if hasattr(kind, "__metadata__"):
        return _of_type(kind.__origin__, [m for m in kind.__metadata__ if not isinstance(m, str)], name, rng)
    parts = [part for part in get_args(kind) if part is not type(None)]
    return _of_type(parts[rng.integers(len(parts))], metadata, name, rng) if parts else None


def _number(kind: type, metadata: list[Any], name: str, rng: np.random.Generator) -> Any:
    found = [*metadata, *(m for part in metadata for m in getattr(part, "metadata", ()))]
    low = next((float(m.ge) if isinstance(m, Ge) else float(m.gt) for m in found if isinstance(m, Ge | Gt)), None)
    high = next((float(m.le) if isinstance(m, Le) else float(m.lt) for m in found if isinstance(m, Le | Lt)), None)
    open_low = any(isinstance(m, Gt) for m in found)
    if low is None:
        low = -UNBOUNDED if high is None else high - UNBOUNDED
    if high is None:
        high = low + UNBOUNDED
    high = min(high, COSTLY.get(name, high))
    if kind is int:
        return (
            2 ** int(rng.integers(4, int(math.log2(high)) + 1)) if name == "size" else int(rng.integers(low, high + 1))
        )
    least = low + 1e-6 * (high - low) if open_low else low
    if rng.random() < AN_END:
        return (least, high)[rng.integers(2)]
    if low >= 0.0 and high > 100.0 * max(low, 1e-3):
        return float(np.exp(rng.uniform(math.log(max(least, 1e-4 * high)), math.log(high))))
    return float(rng.uniform(least, high))


def table(model: type[BaseModel], rng: np.random.Generator, share: float = SET) -> dict[str, Any]:
    """Return random values of some of a model's parameters."""
    values: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        if name in LEFT_OUT or rng.random() >= share:
            continue
        value = draw(field, name, rng) if "color" not in name else [float(x) for x in rng.exponential(1.0, 3)]
        if value is not None:
            values[field.alias or name] = value
    return values


def _place(rng: np.random.Generator) -> list[float]:
    """Return a position around the camera: near and far, above the surface, below the ground, at the camera."""
    reach = float(np.exp(rng.uniform(math.log(0.05), math.log(LONGEST_M))))
    direction = rng.normal(size=3)
    return [float(x) for x in reach * direction / np.linalg.norm(direction)]


def scene_of(seed: int, mesh: Path) -> tuple[Scene, np.ndarray]:
    """Return the scene and the plate of a seed; raises what the scene's parser raises."""
    rng = np.random.default_rng((360, seed))
    camera = {"depth_m": float(np.exp(rng.uniform(math.log(0.05), math.log(DEEPEST_M))))}
    water = table(WaterSettings, rng)
    if water.get("type") == "csv":
        water.pop("type")
    if water.get("rule") == "fitted":
        water["bands"] = int(rng.integers(2, 13))
    light = table(LightSettings, rng)
    if light.get("sun") == "date":
        light |= {
            "sun_time": f"2026-{rng.integers(1, 13):02d}-{rng.integers(1, 28):02d}T{rng.integers(24):02d}:00:00+00:00"
        }
    sea_kind = (GerstnerSea, SpectralSea)[rng.integers(2)]
    sea = table(sea_kind, rng, 0.2) | {"model": ("gerstner", "spectral")[sea_kind is SpectralSea]}
    if rng.random() < 0.7:
        sea["tile_m"] = float(rng.uniform(2.0, 20.0))
    objects = []
    for _ in range(int(rng.integers(0, 4) + 1) // 2):
        of = table(ObjectSettings, rng) | {"mesh": str(mesh), "position_m": _place(rng)}
        objects.append(of | {"scale": float(np.exp(rng.uniform(math.log(0.01), math.log(20.0))))})
    data: dict[str, Any] = {
        "plate": {"path": str(mesh)},
        "camera": camera | {k: v for k, v in table(CameraSettings, rng).items() if k != "depth_m"},
        "water": water, "light": light, "sea": sea, "object": objects,
        "caustics": {"size": 64, "grid": 32} | table(CausticSettings, rng),
        "draw": {"samples": 5} | table(DrawSettings, rng),
    }  # fmt: skip
    if rng.random() < 0.5:
        data["receiver"] = table(ReceiverSettings, rng) | {"kind": "plane", "height_m": -float(rng.exponential(4.0))}
    if rng.random() < 0.3:
        data["lamp"] = [table(LampSettings, rng) | {"position_m": _place(rng), "attach": "world"}]
    return scene_from_dict(data, mesh.parent), plate_of(rng)


def plate_of(rng: np.random.Generator) -> np.ndarray:
    """Return a plate (H, W, 3): noise, a gradient, one colour, black, or light far above white."""
    kind = rng.integers(6)
    up = np.linspace(1.0, 0.0, HEIGHT)[:, None, None]
    if kind == 0:
        plate = rng.random((HEIGHT, WIDTH, 3)) ** 3
    elif kind == 1:
        plate = (0.02 + up**2) * rng.random(3) * np.ones((1, WIDTH, 1))
    elif kind == 2:
        plate = np.broadcast_to(rng.random(3) ** 2, (HEIGHT, WIDTH, 3)).copy()
    elif kind == 3:
        plate = np.zeros((HEIGHT, WIDTH, 3))
    elif kind == 4:
        plate = np.exp(rng.normal(0.0, 2.0, (HEIGHT, WIDTH, 3)))
    else:
        plate = 0.1 * up * np.ones((1, WIDTH, 3))
        row, column = rng.integers(0, HEIGHT), rng.integers(0, WIDTH)
        plate[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] = 1.0
    return plate.astype(np.float32)


def run(seed: int, mesh: Path, backends: list[str]) -> dict[str, Any]:
    """Return the verdict on a seed: ok, refused or failed, with the reason."""
    began = time.process_time()
    verdict: dict[str, Any] = {"seed": seed, "verdict": "ok"}
    try:
        scene, plate = scene_of(seed, mesh)
        for backend in backends:
            verdict["backend"] = backend
            image = render_frame(plate, scene, float(seed % 7), backend, index=seed % 100).image_linear
            if not np.all(np.isfinite(image)):
                return verdict | {"verdict": "failed", "why": "not finite"}
            if np.min(image) < 0.0:
                return verdict | {"verdict": "failed", "why": f"negative, {np.min(image):.3g}"}
    except RenderError as error:
        return verdict | {"verdict": "failed", "why": str(error)}
    except Mr360uwError as error:
        return verdict | {"verdict": "refused", "why": str(error)[:300]}
    except Exception as error:  # noqa: BLE001 - every other exception is a fault
        where = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(where.filename).name}:{where.lineno}"
        return verdict | {"verdict": "failed", "why": f"{type(error).__name__}: {str(error)[:200]} at {place}"}
    return verdict | {"s": round(time.process_time() - began, 2)}


def main() -> None:
    """Run the seeds of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", nargs="?", default="0:10000")
    parser.add_argument("--log", type=Path)
    parser.add_argument("--backend", nargs="+", default=["reference", "gl"])
    given = parser.parse_args()
    first, last = (int(x) for x in given.seeds.split(":"))
    done: dict[int, dict[str, Any]] = {}
    if given.log is not None and given.log.exists():
        done = {line["seed"]: line for line in map(json.loads, given.log.read_text().splitlines())}
    np.seterr(all="ignore")
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "whale.glb"
        write_whale(mesh, 4.0, detail="low")
        for seed in range(first, last):
            if seed in done:
                continue
            done[seed] = run(seed, mesh, given.backend)
            if given.log is not None:
                with given.log.open("a") as log:
                    log.write(json.dumps(done[seed]) + "\n")
            if done[seed]["verdict"] == "failed":
                print(json.dumps(done[seed]), flush=True)
    of = [line for seed, line in done.items() if first <= seed < last]
    counts = {kind: sum(line["verdict"] == kind for line in of) for kind in ("ok", "refused", "failed")}
    print(f"{len(of)} scenes: " + ", ".join(f"{n} {kind}" for kind, n in counts.items()))
    sys.exit(counts["failed"] > 0)


if __name__ == "__main__":
    main()
