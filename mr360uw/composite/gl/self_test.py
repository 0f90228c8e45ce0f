# SPDX-License-Identifier: Apache-2.0
"""Self-test of OpenGL on this machine: small pictures by both renderers, their differences, and how long they take."""

from __future__ import annotations

import functools
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mr360uw.cache import Cache
from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.gl.trial_shots import codes, eight_shots, plate
from mr360uw.composite.over import over
from mr360uw.composite.reference import render_layer
from mr360uw.composite.shot import Shot
from mr360uw.errors import GlError
from mr360uw.gl.context import gl_context, gl_device
from mr360uw.reading.disk_cache import kept_arrays
from mr360uw.types import Floats, Layer

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
    """Draw small pictures with both renderers. names: of `trial_shots.eight_shots`; all without any.

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
