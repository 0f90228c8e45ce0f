# SPDX-License-Identifier: Apache-2.0
"""Calls of OpenGL in a frame, bytes that go to the device and come back, waits for it, and a frame's predicted time.

    python benchmarks/cost/gl_calls.py [--width W] [--frames N]

For the four scenes of `pipeline.py rate`: medians over frames after the first two, which compile and upload meshes.
Counted are calls of moderngl, each of which is one to a few calls of OpenGL. A read returns what was drawn, so it waits
until the device has drawn it: it is synchronous. A `wait` is a read that comes after a draw which no earlier read has
waited for; the reads right after it find their pictures done. On a GPU each wait leaves it idle until the processor has
answered; the aim is two in a frame. A copy into a buffer on the device waits for nothing. Places of the waits are
listed with their number a frame. Two more rows are of its blending alone, which has a thread of its own: by the
processor, and on the device as a graphics card does it.

Predicted is the time of a frame with a device behind a queue, of which nothing is known but that a draw is done 200 us
after it was called, and that bytes travel at 10 GB/s: the time that the frame's thread spends outside of moderngl here,
and the delays, of a wait what is left of it by then. How long the device draws, and the driver's own time, are left
out: here both are the processor's.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import moderngl

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.cost.frame_cost import Subject
from benchmarks.pipeline import measured_scenes
from mr360uw.render.frame import lay_over

AIM = 2
"""Waits in a frame that a GPU can hide behind other frames."""
WAIT_S, BYTES_PER_S = 200e-6, 10e9
"""How long after its call a draw is done in the simulated queue [s], and how fast bytes travel [bytes / s]."""
_DRAWS = {moderngl.VertexArray: ("render", "transform"), moderngl.Framebuffer: ("clear",)}
_READS = dict.fromkeys(
    (moderngl.Framebuffer, moderngl.Texture, moderngl.TextureArray, moderngl.Buffer), ("read", "read_into")
)
_WRITES = {moderngl.Texture: ("write",), moderngl.TextureArray: ("write",), moderngl.Buffer: ("write",)}
_MAKES = ("texture", "texture_array", "depth_texture", "buffer")
_OTHERS: dict[type, tuple[str, ...]] = {
    moderngl.Context: ("program", "vertex_array", "framebuffer", "enable", "disable", "enable_only"),
    moderngl.Framebuffer: ("use",), moderngl.Texture: ("use", "build_mipmaps"), moderngl.TextureArray: ("use",),
    moderngl.Uniform: ("write",),
}  # fmt: skip
_PASSING_ON = ("gl_calls.py", "targets.py", "context.py")
"""Files whose functions only pass a read on; its place is what calls them."""


class Calls:
    """Counts of a frame: `of` calls by kind, bytes `up` and `down`; `waits` by the function that reads.

    queue_s: time [s] that a simulated queue adds to the thread's own.
    """

    def __init__(self) -> None:
        self.of: Counter[str] = Counter()
        self.waits: Counter[str] = Counter()
        self.up = self.down = 0
        self.queue_s = 0.0
        self._drawn, self._within = False, 0
        self._began, self._inside_s, self._done_s = time.thread_time(), 0.0, 0.0

    @property
    def own_s(self) -> float:
        """Processor time [s] of the frame's thread outside of moderngl, so far."""
        return time.thread_time() - self._began - self._inside_s

    def counted(self, kind: str, inner: Callable[..., Any]) -> Callable[..., Any]:
        """Return a method of moderngl that is counted; what it calls itself is not."""

        def method(*given: Any, **named: Any) -> Any:
            self._within += 1
            began = time.thread_time()
            try:
                result = inner(*given, **named)
            finally:
                self._within -= 1
            if self._within == 0:
                now_s = self.own_s - (time.thread_time() - began) + self.queue_s
                self._note(kind, given, named, result, now_s)
                self._inside_s += time.thread_time() - began
            return result

        return method

    def _note(self, kind: str, given: tuple[Any, ...], named: dict[str, Any], result: Any, now_s: float) -> None:
        """Count a call. now_s: time [s] of the frame with a simulated queue, up to the call."""
        if kind == "read" and isinstance(given[1] if len(given) > 1 else None, moderngl.Buffer):
            kind = "copy"
        self.of[kind] += 1
        if kind == "draw":
            self._drawn, self._done_s = True, now_s + WAIT_S
        elif kind == "read":
            size = len(result) if isinstance(result, bytes) else memoryview(given[1]).nbytes
            self.down += size
            self.queue_s += max(self._done_s - now_s, 0.0) + size / BYTES_PER_S
            if self._drawn:
                self.waits[_place()] += 1
            self._drawn = False
        elif kind in ("write", "make"):
            values = [*given[1:], named.get("data")]
            size = next((memoryview(v).nbytes for v in values if _is_data(v)), 0)
            self.up += size
            self.queue_s += size / BYTES_PER_S


def _is_data(value: Any) -> bool:
    return value is not None and not isinstance(value, (int, float, str, tuple, list))


def _place() -> str:
    """Return the file and the function that reads."""
    for frame in reversed(traceback.extract_stack()):
        path = Path(frame.filename)
        if "moderngl" not in path.parts and path.name not in _PASSING_ON and not frame.name.startswith("<"):
            return f"{path.parent.name}/{path.name} {frame.name}"
    return "?"


@contextmanager
def counting(calls: list[Calls]) -> Iterator[None]:
    """Count the calls of moderngl into the last of `calls` until the context ends."""
    kinds = [
        *((owner, name, "draw") for owner, names in _DRAWS.items() for name in names),
        *((owner, name, "read") for owner, names in _READS.items() for name in names),
        *((owner, name, "write") for owner, names in _WRITES.items() for name in names),
        *((moderngl.Context, name, "make") for name in _MAKES),
        *((owner, name, "other") for owner, names in _OTHERS.items() for name in names),
    ]
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in kinds]
    counts = calls[-1]
    for (owner, name, inner), (_, _, kind) in zip(before, kinds, strict=True):
        setattr(owner, name, counts.counted(kind, inner))
    try:
        yield
    finally:
        for owner, name, inner in before:
            setattr(owner, name, inner)


def count(frame: Callable[[], object], frames: int) -> tuple[list[Calls], list[float]]:
    """Return the calls of each of some frames, and the processor time [s] of their thread outside of moderngl."""
    calls: list[Calls] = []
    own: list[float] = []
    for _ in range(frames):
        calls.append(Calls())
        with counting(calls):
            frame()
            own.append(calls[-1].own_s)
    return calls, own


def report(what: str, calls: list[Calls], own: list[float]) -> None:
    """Print medians of the calls of frames, and where they wait. own: see `count`."""

    def median(of: Callable[[Calls], float]) -> float:
        return statistics.median(map(of, calls))

    kinds = ("draw", "read", "copy", "write", "make", "other")
    cells = " ".join(f"{median(lambda c, kind=kind: c.of[kind]):6g}" for kind in kinds)  # type: ignore[misc]
    waits = median(lambda c: c.waits.total())
    sizes = f"{median(lambda c: c.up) / 1024:8.0f} {median(lambda c: c.down) / 1024:8.0f}"
    print(f"{what:28} {cells} {sizes} {waits:6g}  aim {AIM}: {'met' if waits <= AIM else 'not met'}")
    own_ms, queue_ms = 1e3 * statistics.median(own), 1e3 * median(lambda c: c.queue_s)
    print(f"{'':28}   predicted {own_ms + queue_ms:.1f} ms: own {own_ms:.1f}, waits and transfers {queue_ms:.1f}")
    places = sum((c.waits for c in calls), Counter[str]())
    for place, number in places.most_common():
        print(f"{'':28}   {number / len(calls):.1f} waits in {place}")


def main() -> None:
    """Print the counts of the four scenes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=1024)
    parser.add_argument("--frames", type=int, default=5)
    given = parser.parse_args()
    kinds = " ".join(f"{kind:>6}" for kind in ("draws", "reads", "copies", "writes", "makes", "others"))
    print(f"{'scene':28} {kinds} {'KiB up':>8} {'KiB down':>8} {'waits':>6}")
    with tempfile.TemporaryDirectory() as folder:
        for what, scene in measured_scenes(Path(folder), None, given.width, frames=given.frames + 3).items():
            subject = Subject(scene)
            subject.frame()
            report(what, *count(subject.frame, given.frames))
            for where, on_device in (("processor", False), ("device", True)):
                blend = partial(lay_over, subject.last.plate, subject.last.layer, 0.0, on_device)
                blend()
                report(f"  blending, {where}", *count(blend, given.frames))


if __name__ == "__main__":
    main()
