# SPDX-License-Identifier: Apache-2.0
"""Views into a panorama: ours against py360convert and FFmpeg's v360, error and processor time.

    python benchmarks/peers/projection.py [--width W]

The panorama is a pattern of waves over the sphere, known in every direction, the shortest six pixels long at the
equator; the view is finer than it, so that interpolation alone is measured. Error: relative RMSE of the view against
the pattern in the directions of its pixels. Times are processor time of one view, medians; `first` includes tables that
the program keeps for the next view of the same kind. v360 comes with PyAV and has integers alone: 16 bits here. For
py360convert: `pip install py360convert`.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from mr360uw.base.sphere import directions
from mr360uw.preview.screen import look, perspective
from mr360uw.types import Floats

_VIEWS = {
    "level": (30.0, 0.0),
    "up, over the pole": (30.0, 75.0),
}
"""Azimuth and elevation of the views' middles [deg]."""
_FOV_DEG, _WIDTH, _HEIGHT = 75.0, 1280, 720
_TALL_DEG = np.degrees(2.0 * np.arctan(np.tan(0.5 * np.radians(_FOV_DEG)) * _HEIGHT / _WIDTH))
_WAVES = 24
_RUNS = 9
_CODES = 65535.0

Work = Callable[[], Floats]
"""Makes one view (H, W, 3)."""


def pattern(width: int) -> Callable[[Floats], Floats]:
    """Return a pattern (..., 3) over unit directions (..., 3), with waves of six pixels of a panorama and longer."""
    rng = np.random.default_rng(7)
    wave = rng.normal(size=(_WAVES, 3))
    wave *= (width / 6.0 * rng.uniform(0.1, 1.0, _WAVES) / np.linalg.norm(wave, axis=-1))[:, None]
    phase, weight = rng.uniform(0.0, 2.0 * np.pi, _WAVES), rng.uniform(0.0, 1.0, (_WAVES, 3)) / _WAVES
    return lambda to: 0.5 + 0.8 * np.sin(to @ wave.T + phase) @ weight


def _ours(panorama: Floats, yaw_deg: float, pitch_deg: float) -> Iterator[tuple[str, Work]]:
    yield "mr360uw", lambda: look(panorama, perspective(yaw_deg, pitch_deg, _FOV_DEG, _WIDTH, _HEIGHT))


def _v360(panorama: Floats, yaw_deg: float, pitch_deg: float) -> Iterator[tuple[str, Work]]:
    import av

    codes = np.ascontiguousarray(np.round(_CODES * panorama).astype(np.uint16)[..., [1, 2, 0]])
    for interpolation in ("linear", "cubic", "lanczos"):
        graph = av.filter.Graph()
        height, width = panorama.shape[:2]
        source = graph.add_buffer(width=width, height=height, format="gbrp16le", time_base="1/24")
        wanted = (
            f"input=e:output=flat:yaw={yaw_deg}:pitch={pitch_deg}:h_fov={_FOV_DEG}:v_fov={_TALL_DEG}"
            f":w={_WIDTH}:h={_HEIGHT}:interp={interpolation}"
        )
        last = source
        for name, given in (("v360", wanted), ("buffersink", None)):
            node = graph.add(name, given)
            last.link_to(node)
            last = node
        graph.configure()

        def work(graph: av.filter.Graph = graph, width: int = width, height: int = height) -> Floats:
            frame = av.VideoFrame(width, height, "gbrp16le")
            for plane, values in zip(frame.planes, np.moveaxis(codes, -1, 0), strict=True):
                rows = np.zeros((height, plane.line_size // 2), np.uint16)
                rows[:, :width] = values
                plane.update(rows)
            frame.time_base = 1
            graph.push(frame)
            made = graph.pull()
            planes = [np.frombuffer(plane, np.uint16).reshape(_HEIGHT, -1)[:, :_WIDTH] for plane in made.planes[:3]]
            return (np.stack(planes, axis=-1)[..., [2, 0, 1]] / _CODES).astype(np.float32)

        yield f"FFmpeg v360, {interpolation}, 16 bits", work


def _py360convert(panorama: Floats, yaw_deg: float, pitch_deg: float) -> Iterator[tuple[str, Work]]:
    try:
        from py360convert import e2p
    except ImportError:
        print("left out: py360convert is not installed (pip install py360convert)")
        return
    for mode in ("bilinear", "bicubic"):

        def work(mode: str = mode) -> Floats:
            size = (_HEIGHT, _WIDTH)
            seen: Floats = e2p(panorama, (_FOV_DEG, _TALL_DEG), yaw_deg, pitch_deg, size, mode=mode)
            return seen

        yield f"py360convert, {mode}", work


def compare(width: int) -> None:
    """Print errors and times of every program for every view."""
    of = pattern(width)
    panorama = of(directions(width, width // 2)).astype(np.float32)
    for name, angles in _VIEWS.items():
        truth = of(perspective(*angles, _FOV_DEG, _WIDTH, _HEIGHT).pixel_directions())
        level = float(np.sqrt(np.mean((truth - truth.mean()) ** 2)))
        print(f"{name}: panorama {width} x {width // 2}, view {_WIDTH} x {_HEIGHT}, {_FOV_DEG:g} degrees")
        print(f"  {'':32} {'error':>8} {'first ms':>9} {'next ms':>9}")
        for make in (_ours, _py360convert, _v360):
            for what, work in make(panorama, *angles):
                times, seen = [], truth
                for _ in range(_RUNS):
                    began = time.process_time()
                    seen = work()
                    times.append(1e3 * (time.process_time() - began))
                error = float(np.sqrt(np.mean((seen - truth) ** 2))) / level
                print(f"  {what:32} {error:8.4f} {times[0]:9.1f} {statistics.median(times[1:]):9.1f}", flush=True)


def main() -> None:
    """Read the command line and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=2048)
    compare(parser.parse_args().width)


if __name__ == "__main__":
    main()
