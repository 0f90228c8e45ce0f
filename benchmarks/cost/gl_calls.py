# SPDX-License-Identifier: Apache-2.0
"""Calls of OpenGL in a frame, bytes that go to the device and come back, waits for it, and a frame's predicted time.

    python benchmarks/cost/gl_calls.py [--width W] [--frames N] [--depth D ...]

For the four scenes of `pipeline.py rate`, with their frames drawn one after the other on one thread (depth 0), and with
several under way at a time as on a graphics card (`threads.in_flight`): means over frames after the first, which
compile and upload meshes. Counted are calls of moderngl, each of which is one to a few calls of OpenGL. A read returns
what was drawn, so it waits until the device has drawn it: it is synchronous. A `wait` is a read that comes after a draw
which no earlier read has waited for; the reads right after it find their pictures done. On a GPU each wait leaves it
idle until the processor has answered; the aim is one a frame. A copy into a buffer on the device waits for nothing.
Places of the waits are listed with their number a frame. Two more rows are of its blending alone, which has a thread of
its own: by the processor, and on the device as a graphics card does it.

Predicted is how long the thread of OpenGL takes for a frame with a device behind a queue, of which nothing is known but
that a draw is done 200 us after it was called, and that bytes travel at 10 GB/s: the processor time that the thread
spends outside of moderngl here, and the delays, of a wait what is left of it by then. How long the device draws, and
the driver's own time, are left out: here both are the processor's. `beside` is the processor time of the frame on other
threads, which those of several frames share.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import threading
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

from benchmarks.pipeline import measured_scenes
from mr360uw.cache import Cache
from mr360uw.render.backends import make_backend
from mr360uw.render.first_pass import clip_analysis
from mr360uw.render.frame import DrawnFrame, draw_frame, lay_over, measure_plate
from mr360uw.render.loaded import load
from mr360uw.render.stages.light_stage import LightSamples
from mr360uw.scene.inputs import open_plate
from mr360uw.scene.model import Scene
from mr360uw.steps import Steps
from mr360uw.threads import in_flight, one_blas_thread

AIM, AIM_MS = 1, 30.0
"""Waits in a frame, and processor time [ms] of the thread of OpenGL, that leave the device busy."""
WAIT_S, BYTES_PER_S = 200e-6, 10e9
"""How long after its call a draw is done in the simulated queue [s], and how fast bytes travel [bytes / s]."""
_FIRST = 4
"""Frames that are not counted."""
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
_PASSING_ON = ("gl_calls.py", "targets.py", "context.py", "layer_renderer.py", "backends.py")
"""Files whose functions only pass a read on; its place is what calls them."""


class Calls:
    """Counts of frames: `of` calls by kind, bytes `up` and `down`; `waits` by the function that reads.

    own_s: processor time [s] of the thread of OpenGL outside of moderngl. queue_s: what a simulated queue adds to it.
    beside_s: processor time [s] of other threads.
    """

    def __init__(self) -> None:
        self.of: Counter[str] = Counter()
        self.waits: Counter[str] = Counter()
        self.up = self.down = 0
        self.queue_s = self.own_s = self.beside_s = 0.0
        self._drawn, self._within = False, 0
        self._began, self._inside_s, self._done_s = time.thread_time(), 0.0, 0.0

    def own_so_far(self) -> float:
        """Return the processor time [s] of the thread of OpenGL outside of moderngl, since this was made."""
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
                now_s = self.own_so_far() - (time.thread_time() - began) + self.queue_s
                self._note(kind, given, named, result, now_s)
                self._inside_s += time.thread_time() - began
            return result

        return method

    def _note(self, kind: str, given: tuple[Any, ...], named: dict[str, Any], result: Any, now_s: float) -> None:
        """Count a call. now_s: time [s] of the thread with a simulated queue, up to the call."""
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
def counting(counts: Calls) -> Iterator[None]:
    """Count the calls of moderngl until the context ends."""
    kinds = [
        *((owner, name, "draw") for owner, names in _DRAWS.items() for name in names),
        *((owner, name, "read") for owner, names in _READS.items() for name in names),
        *((owner, name, "write") for owner, names in _WRITES.items() for name in names),
        *((moderngl.Context, name, "make") for name in _MAKES),
        *((owner, name, "other") for owner, names in _OTHERS.items() for name in names),
    ]
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in kinds]
    for (owner, name, inner), (_, _, kind) in zip(before, kinds, strict=True):
        setattr(owner, name, counts.counted(kind, inner))
    try:
        yield
    finally:
        counts.own_s = counts.own_so_far()
        for owner, name, inner in before:
            setattr(owner, name, inner)


def count(scene: Scene, frames: int, depth: int) -> tuple[Calls, DrawnFrame]:
    """Return the calls of some frames of a scene, of which `depth` are under way at a time, and their time; and the
    last of the frames.
    """
    backend, kept, calls = make_backend("gl")[0], Cache(), [Calls()]
    with open_plate(scene) as video:
        loaded = load(scene, video.width, video.height)
        analysis = clip_analysis(loaded, video)
        lit = LightSamples(loaded, analysis, video, video.frames).frames(0, video.frame_count)
        plates = [measure_plate(loaded, analysis, plate, kept, light) for plate, light in lit]

    def timed(steps: Steps[DrawnFrame]) -> Steps[DrawnFrame]:
        while True:
            began, beside = time.thread_time(), threading.current_thread() is not threading.main_thread()
            try:
                pause = next(steps)
            except StopIteration as done:
                drawn: DrawnFrame = done.value
                return drawn
            finally:
                calls[-1].beside_s += time.thread_time() - began if beside else 0.0
            yield pause

    drawn = (timed(draw_frame(loaded, backend, plate, 0.0, Cache())) for plate in itertools.cycle(plates))
    with one_blas_thread():
        flight = in_flight(drawn, backend.answer, depth)
        for _ in range(_FIRST + depth):
            next(flight)
        calls.append(Calls())
        with counting(calls[-1]):
            for _ in range(frames):
                last = next(flight)
        flight.close()
    return calls[-1], last


def count_blending(drawn: DrawnFrame, frames: int, *, on_device: bool) -> Calls:
    """Return the calls of a frame that is laid over its plate some times, and their time."""
    (eye,), ((_, layer, _),) = drawn.measured.eyes, drawn.by_eye[0]
    blend = partial(lay_over, eye.plate, layer, 0.0, on_device)
    blend()
    calls = Calls()
    with counting(calls):
        for _ in range(frames):
            blend()
    return calls


def report(what: str, depth: int, calls: Calls, frames: int) -> None:
    """Print means of the calls of frames, and where they wait. Frames at rest end at uneven times, so parts occur."""
    kinds = ("draw", "read", "copy", "write", "make", "other")
    cells = " ".join(f"{calls.of[kind] / frames:6.1f}" for kind in kinds)
    waits, own_ms = calls.waits.total() / frames, 1e3 * calls.own_s / frames
    sizes = f"{calls.up / frames / 1024:8.0f} {calls.down / frames / 1024:8.0f}"
    print(f"{what:28} {depth:5} {cells} {sizes} {waits:6.1f}  aim {AIM}: {'met' if round(waits) <= AIM else 'not met'}")
    queue_ms, beside_ms = 1e3 * calls.queue_s / frames, 1e3 * calls.beside_s / frames
    met = "met" if own_ms <= AIM_MS else "not met"
    print(f"{'':34} predicted {own_ms + queue_ms:.1f} ms: own {own_ms:.1f} (aim {AIM_MS:.0f}: {met}), waits and "
          f"transfers {queue_ms:.1f}; beside {beside_ms:.1f}")  # fmt: skip
    for place, number in calls.waits.most_common():
        print(f"{'':34} {number / frames:.1f} waits in {place}")


def main() -> None:
    """Print the counts of the four scenes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--width", type=int, default=1024)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--depth", type=int, nargs="+", default=[0, 5])
    given = parser.parse_args()
    kinds = " ".join(f"{kind:>6}" for kind in ("draws", "reads", "copies", "writes", "makes", "others"))
    print(f"{'scene':28} depth {kinds} {'KiB up':>8} {'KiB down':>8} {'waits':>6}")
    with tempfile.TemporaryDirectory() as folder:
        for what, scene in measured_scenes(Path(folder), None, given.width, frames=given.frames + 3).items():
            for depth in given.depth:
                calls, drawn = count(scene, given.frames, depth)
                report(what, depth, calls, given.frames)
            for where, on_device in (("processor", False), ("device", True)):
                report(
                    f"  blending, {where}", 0, count_blending(drawn, given.frames, on_device=on_device), given.frames
                )


if __name__ == "__main__":
    main()
