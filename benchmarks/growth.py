# SPDX-License-Identifier: Apache-2.0
"""How the processor time of a frame grows with the size of a scene, and which of it should not grow at all.

    python benchmarks/growth.py [CURVE ...] [--quick] [--rounds N]

Curves: objects, triangles, touched, width, bands, frames; without names, all of them. --quick: fewer and smaller
points.

A frame is one of a sample dive with a ball that moves, so that nothing of its layer is kept from the last frame; it is
decoded before and not encoded. Its parts: `light` measured in the plate, `water` (its table for the frame), `caustics`,
`layer` (all that is drawn) and `blend` over the plate. Times are processor time of all threads of the process, medians
over the rounds. In each round every point of a curve draws one frame, so that what slows the machine slows them all.

Every curve names what should be flat: the largest change from its first point, the median of the ratios round by round,
with the standard error of that median. Flat is within 3 %, error included; not flat is more than 3 % by three standard
errors.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.cost.clip_cost import clip_costs
from benchmarks.cost.frame_cost import PARTS, FrameCost, Subject, ratio, take_turns
from benchmarks.cost.growing_scenes import Dives, balls, filling_ball, one_ball

FLAT = 0.03
"""Growth from the first to the last point of a curve that counts as none."""
_SURE = 3.0
"""Standard errors within which a change is not told from none."""
_WIDTH, _QUICK_WIDTH = 1024, 512


@dataclass(frozen=True, slots=True)
class Curve:
    """One quantity that grows. flat: parts of a frame that should cost the same at every point, and the reason."""

    name: str
    unit: str
    flat: tuple[str, ...]
    why: str
    points: tuple[float, ...]
    quick: tuple[float, ...]
    subject: Callable[[Dives, float, int], Subject]


def _objects(dives: Dives, count: float, width: int) -> Subject:
    return dives.subject(width, balls(dives.folder, int(count)))


def _triangles(dives: Dives, count: float, width: int) -> Subject:
    return dives.subject(width, one_ball(dives.folder, int(count)))


def _touched(dives: Dives, percent: float, width: int) -> Subject:
    return dives.subject(width, filling_ball(dives.folder, percent / 100.0))


def _width(dives: Dives, columns: float, _: int) -> Subject:
    return dives.subject(int(columns), one_ball(dives.folder, 1000))


def _bands(dives: Dives, count: float, width: int) -> Subject:
    return dives.subject(width, one_ball(dives.folder, 1000) | {"water": {"type": "IB", "bands": int(count)}})


CURVES = (
    Curve(
        "objects", "objects", ("light", "water", "caustics"), "they cover the same part of the frame in all",
        (1, 3, 10, 30, 100), (1, 10, 100), _objects,
    ),
    Curve(
        "triangles", "triangles of a ball that moves", ("light", "water", "caustics", "blend"),
        "the ball covers the same pixels",
        (1e3, 1e4, 1e5, 1e6), (1e3, 3e4), _triangles,
    ),
    Curve(
        "touched", "% of the sphere", ("light", "water", "caustics"), "work outside the tiles",
        (0.5, 2, 8, 30), (0.5, 30), _touched,
    ),
    Curve(
        "width", "columns", ("water", "caustics"), "they know nothing of the plate's pixels",
        (1024, 2048, 4096, 8192), (512, 1024), _width,
    ),
    Curve(
        "bands", "bands", (*PARTS, "frame"), "one fetch a pixel, whatever the bands",
        (3, 21, 61, 241, 1000), (3, 61), _bands,
    ),
)  # fmt: skip


def measure(curve: Curve, dives: Dives, *, quick: bool, rounds: int) -> list[FrameCost]:
    """Return what a frame costs at every point of a curve, and print it."""
    width = _QUICK_WIDTH if quick else _WIDTH
    points = curve.quick if quick else curve.points
    costs = take_turns([curve.subject(dives, point, width) for point in points], rounds)
    print(f"{curve.unit:>32} {'tiles':>7} " + " ".join(f"{name:>9}" for name in (*PARTS, "frame")) + "   once")
    for point, cost in zip(points, costs, strict=True):
        cells = " ".join(f"{cost.ms[name]:9.2f}" for name in (*PARTS, "frame"))
        print(f"{point:32g} {100 * cost.touched:6.2f}% {cells} {cost.once_s:6.1f}s")
    for name in curve.flat:
        print("  " + verdict(name, [cost.samples[name] for cost in costs]) + f" ({curve.why})")
    for name in (*PARTS, "frame"):
        if name not in curve.flat:
            print(f"  {name}: x {_ratio([cost.ms[name] for cost in costs]):.2f} over x {points[-1] / points[0]:g}")
    return costs


def verdict(name: str, samples: Sequence[Sequence[float]]) -> str:
    """Return whether times are flat: within 3 % of each other. samples: those of each point, round by round."""
    ratios = [ratio(values, samples[0]) for values in samples[1:]]
    found, noise = max(ratios, key=lambda r: abs(r[0] - 1.0))
    change = abs(found - 1.0)
    word = "flat" if change + noise <= FLAT else "NOT FLAT" if change - _SURE * noise > FLAT else "not told from flat"
    return f"{name}: {word}, largest change from the first point {found - 1.0:+.1%} +- {noise:.1%}"


def _ratio(values: Sequence[float]) -> float:
    return values[-1] / values[0] if values[0] > 0.0 else 1.0 if values[-1] == values[0] else math.inf


def frames(dives: Dives, *, quick: bool) -> dict[int, tuple[float, float]]:
    """Return processor time [ms] a frame and peak memory [MiB] by number of frames, and print them."""
    found = clip_costs(dives, (12, 24, 96) if quick else (60, 240, 960), _QUICK_WIDTH)
    print(f"{'frames':>32} {'ms a frame':>11} {'peak MiB':>9}")
    for count, (cost_ms, peak) in found.items():
        print(f"{count:32d} {cost_ms:11.2f} {peak:9.0f}")
    counts, costs = list(found), list(found.values())
    spent = [count * cost_ms for count, (cost_ms, _) in found.items()]
    further = [(b - a) / (n - m) for a, b, m, n in zip(spent, spent[1:], counts, counts[1:], strict=False)]
    print(f"  a further frame: {', '.join(f'{ms:.1f} ms' for ms in further)} (without what is done once)")
    changes = {"a further frame": further[-1] / further[0] - 1.0, "memory": costs[-1][1] / costs[0][1] - 1.0}
    for name, change in changes.items():
        print(f"  {name}: {'does not grow' if change <= FLAT else 'GROWS'}, last over first {change:+.1%}")
    return found


def main() -> None:
    """Measure the curves named on the command line, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [curve.name for curve in CURVES] + ["frames"]
    parser.add_argument("curves", nargs="*", choices=[*names, []], metavar="CURVE")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--rounds", type=int)
    given = parser.parse_args()
    rounds = given.rounds or (5 if given.quick else 15)
    with tempfile.TemporaryDirectory() as folder:
        dives = Dives(Path(folder))
        for curve in _chosen(given.curves):
            print(f"== {curve.name}", flush=True)
            measure(curve, dives, quick=given.quick, rounds=rounds)
        if not given.curves or "frames" in given.curves:
            print("== frames", flush=True)
            frames(dives, quick=given.quick)


def _chosen(names: Iterable[str]) -> list[Curve]:
    wanted = set(names)
    return [curve for curve in CURVES if not wanted or curve.name in wanted]


if __name__ == "__main__":
    main()
