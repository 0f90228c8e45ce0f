# SPDX-License-Identifier: Apache-2.0
"""Random legal scenes on one renderer: python benchmarks/stress.py --backend reference --count 1000 --log FILE.

A seed makes one scene of 256 x 128 pixels, always the same (`random_scenes`), and its first frame is composited as a
video's is. Findings, each printed as it is found:

    refused     with the message: the scene was meant to be legal
    not finite  a NaN or an infinity in the picture
    negative    light below -1e-6 of the plate's brightest, or of 1, where the plate itself has none, in the layer over
                the plate: in Rec.709, where a wider gamut's own colours are negative, and in the plate's primaries
    codes       the same in the picture, with its grain, as it is read back from its codes, in the plate's primaries
    failed      any exception that is none of the toolkit's own, or a process that died or took too long
    memory      peak memory of the process above 3 GB during the scene

Seeds that stand in the log are not run again. Leaves with 1 if anything was found beside refusals, or if more than one
scene in twenty was refused. One seed again, with its scene file and a traceback: --first-seed SEED --show FOLDER.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.random_scenes import RandomScene, random_scene  # noqa: E402
from mr360uw.base.color import in_plate_primaries  # noqa: E402
from mr360uw.composite.tiles import over  # noqa: E402
from mr360uw.errors import Mr360uwError, RenderError, SceneError  # noqa: E402
from mr360uw.render.first_pass import clip_analysis  # noqa: E402
from mr360uw.render.frame import Backend, Frame, composite_frame, make_backend, not_finite  # noqa: E402  # noqa: E402
from mr360uw.render.loaded import load  # noqa: E402
from mr360uw.scene.resolved import open_plate  # noqa: E402

DARKEST = -1e-6
"""Least light that counts as none, for a plate whose brightest light is 1: rounding of single precision."""
MOST_GB = 3.0
MOST_REFUSED = 0.05
SEEDS_AT_ONCE = 12
"""Scenes that a process makes before the next takes over: what one leaves behind does not add up."""
LONGEST_S = 900.0
"""Time of a scene after which its process is ended."""


def frame_of(made: RandomScene, backend: Backend) -> Frame:
    """Return the first frame of a scene, composited as that of a video."""
    scene = made.scene()
    with open_plate(scene) as video:
        loaded = load(scene, video.width, video.height, clip=not video.is_still)
        loaded.check(1)
        analysis = clip_analysis(loaded, video)
        exposure_s = scene.draw.exposure_s(video.frame_rate)
        return composite_frame(loaded, analysis, backend, next(iter(video.frames(0, 1))), exposure_s)


def problems_of(frame: Frame) -> Iterator[tuple[str, str]]:
    """Yield the kind and the words of what is wrong with a frame, and with that of its right eye."""
    if found := not_finite((frame.layer,)):
        yield "not finite", found
        return
    filed, spec = frame.plate.graded_by(None), frame.plate.spec
    if not np.all(np.isfinite(frame.picture.light)):
        yield "not finite", "picture"
    plate, own = frame.plate.image_linear, filed.image_linear
    light, shown = over(plate, frame.layer), frame.picture.light
    for kind, found, before in (
        ("negative", light, plate),
        ("negative", in_plate_primaries(light, spec), in_plate_primaries(plate, spec)),
        ("codes", in_plate_primaries(shown, spec), in_plate_primaries(own, spec)),
    ):
        below = found - np.minimum(before, 0.0)
        if below.min() < DARKEST * max(1.0, float(np.abs(before).max())):
            row, column, _ = np.unravel_index(int(np.argmin(below)), below.shape)
            least = [f"{part:.3g}" for part in found[row, column]]
            yield kind, f"{np.sum(below < DARKEST)} values, least {', '.join(least)} at row {row}, column {column}"
    if frame.right is not None:
        yield from ((kind, f"right eye: {words}") for kind, words in problems_of(frame.right))


def verdict_on(seed: int, folder: Path, backend: Backend) -> dict[str, Any]:
    """Return what became of a seed's scene: its kind, its words, seconds and peak memory."""
    began, found = time.monotonic(), {"seed": seed, "kind": "ok", "why": ""}
    reset_peak()
    try:
        frame = frame_of(random_scene(seed, folder), backend)
        for kind, words in problems_of(frame):
            found |= {"kind": kind, "why": words}
            break
    except RenderError as error:
        found |= {"kind": "not finite", "why": str(error)}
    except SceneError as error:
        found |= {"kind": "refused", "why": "; ".join(error.problems)}
    except Mr360uwError as error:
        found |= {"kind": "refused", "why": str(error)}
    except Exception as error:  # noqa: BLE001 - any other exception is a fault
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(last.filename).name}:{last.lineno}"
        found |= {"kind": "failed", "why": f"{type(error).__name__}: {str(error)[:200]} at {place}"}
    peak = peak_gb()
    if peak > MOST_GB and found["kind"] == "ok":
        found |= {"kind": "memory", "why": f"{peak:.2f} GB"}
    return found | {"s": round(time.monotonic() - began, 2), "gb": round(peak, 2)}


def reset_peak() -> None:
    """Count this process's peak memory from now on (Linux)."""
    Path("/proc/self/clear_refs").write_text("5")


def peak_gb() -> float:
    """Return this process's peak memory [GB] since `reset_peak`."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1e-6 * 1.024 * float(next(line for line in lines if line.startswith("VmHWM")).split()[1])


def work(seeds: list[int], backend_name: str) -> None:
    """Print the verdict on every seed as one line; what a process of its own does."""
    np.seterr(all="ignore")
    backend, _ = make_backend(backend_name)
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            print(json.dumps({"began": seed}), flush=True)
            print(json.dumps(verdict_on(seed, Path(folder), backend)), flush=True)


def verdicts(seeds: list[int], backend: str) -> Iterator[dict[str, Any]]:
    """Yield the verdicts of processes on seeds; a process that dies or hangs costs the one that it was at."""
    while seeds:
        command = [sys.executable, __file__, "--work", json.dumps(seeds), "--backend", backend]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
            at, done, limit = seeds[0], 0, threading.Timer(LONGEST_S, process.kill)
            assert process.stdout is not None
            for line in process.stdout:
                said = json.loads(line)
                if "began" in said:
                    limit.cancel()
                    at, limit = said["began"], threading.Timer(LONGEST_S, process.kill)
                    limit.start()
                    continue
                done += 1
                yield said
            limit.cancel()
            code = process.wait()
        seeds = seeds[done:]
        if seeds:
            yield {"seed": at, "kind": "failed", "why": f"the process ended with {code}", "s": 0.0, "gb": 0.0}
            seeds = [seed for seed in seeds if seed != at]


def show(seed: int, folder: Path, backend: str) -> None:
    """Write the scene of a seed and its files into a folder, and make its frame; exceptions are shown."""
    folder.mkdir(parents=True, exist_ok=True)
    made = random_scene(seed, folder.resolve())
    (folder / f"{seed}.toml").write_text(made.scene().to_toml())
    for problem in problems_of(frame_of(made, make_backend(backend)[0])):
        print(*problem, sep=": ")


def main() -> None:
    """Run the seeds of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--backend", default="reference", choices=["reference", "gl"])
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--log", type=Path, help="one line of JSON for every seed; goes on where it ends")
    parser.add_argument("--show", type=Path, metavar="FOLDER")
    parser.add_argument("--work", type=json.loads, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.work is not None:
        return work(given.work, given.backend)
    if given.show is not None:
        return show(given.first_seed, given.show, given.backend)
    wanted = range(given.first_seed, given.first_seed + given.count)
    logged = given.log.read_text().splitlines() if given.log is not None and given.log.exists() else []
    done = {line["seed"]: line for line in map(json.loads, logged) if line["backend"] == given.backend}
    left = [seed for seed in wanted if seed not in done]
    batches = [left[k : k + SEEDS_AT_ONCE] for k in range(0, len(left), SEEDS_AT_ONCE)]

    def run(batch: list[int]) -> None:
        for found in verdicts(batch, given.backend):
            found["backend"] = given.backend
            done[found["seed"]] = found
            if given.log is not None:
                with given.log.open("a") as log:
                    log.write(json.dumps(found) + "\n")
            if found["kind"] != "ok":
                print(f"seed {found['seed']}: {found['kind']} - {found['why']}", flush=True)

    with ThreadPoolExecutor(given.processes) as pool:
        list(pool.map(run, batches))
    of = [done[seed] for seed in wanted if seed in done]
    counts = Counter(line["kind"] for line in of)
    print(f"{len(of)} scenes on {given.backend}: " + ", ".join(f"{n} {kind}" for kind, n in counts.most_common()))
    seconds, peaks = [line["s"] for line in of], [line["gb"] for line in of]
    print(f"seconds a scene: median {np.median(seconds):.2f}, most {max(seconds)}; peak memory: most {max(peaks)} GB")
    refused = counts["refused"] > MOST_REFUSED * len(of)
    sys.exit(bool(refused or set(counts) - {"ok", "refused"}))


if __name__ == "__main__":
    main()
