# SPDX-License-Identifier: Apache-2.0
"""The stages that are measured in frames of a sample dive: light of the plate, shadows, edges, whole frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mr360uw.bench.measuring import Knobs, MeasuredStage, Workbench, Workload, picture_of, qualities, relative_rms
from mr360uw.constants import MAXIMUM_SUN_SAMPLES
from mr360uw.ibl import environment
from mr360uw.types import Floats

_FRAME = "a frame of a swimming whale over sand, from the decoded plate to the codes"
_SCALES = (1.0, 0.5, 0.25, 0.125, 0.0625)
_COUNTS = (1, 5, 13, 17, 29, 41, 65)


def light_stage() -> MeasuredStage:
    """Light of the plate: size of the frame that it is measured in."""
    scales = tuple({"plate.scale": scale} for scale in _SCALES)
    return MeasuredStage(
        "light",
        "Light of the plate: size of the frame",
        "environment, irradiance and sun of one frame",
        "the same of the whole frame: irradiance in all directions",
        scales,
        scales[:3],
        {"default": {"plate.scale": 1.0}},
        _open_light,
    )


def sun_stage() -> MeasuredStage:
    """Soft shadows: directions over the light's disc."""
    counts = (1, 2, 4, 6, 8, 12, 16, 24, MAXIMUM_SUN_SAMPLES)
    return MeasuredStage(
        "sun",
        "Soft shadows: directions over the sun's disc",
        _FRAME,
        f"{MAXIMUM_SUN_SAMPLES} directions: radiance where the whale or its shadow is",
        tuple({"draw.sun_samples": count} for count in counts),
        tuple({"draw.sun_samples": count} for count in counts[::4]),
        qualities("draw.sun_samples"),
        lambda bench: frames_against(bench, {"draw.sun_samples": MAXIMUM_SUN_SAMPLES}),
    )


def pixel_stage() -> MeasuredStage:
    """Edges and textures: samples of a pixel, shaded together or one by one."""

    def of(shading: str, *counts: int) -> tuple[Knobs, ...]:
        return tuple({"draw.samples": count, "draw.shading": shading} for count in counts)

    return MeasuredStage(
        "pixels",
        "Edges: samples of a pixel, and how they are shaded",
        _FRAME,
        "65 samples shaded one by one: radiance where the whale or its shadow is",
        (*of("pixel", *_COUNTS), *of("sample", *_COUNTS)),
        of("pixel", 1, 5, 29),
        qualities("draw.samples", "draw.shading"),
        lambda bench: frames_against(bench, {"draw.samples": 65, "draw.shading": "sample"}),
    )


def frame_stage() -> MeasuredStage:
    """Whole frames: quality and size."""

    def of(*scales: float) -> tuple[Knobs, ...]:
        return tuple({"draw.quality": q, "plate.scale": s} for s in scales for q in ("draft", "final", "reference"))

    return MeasuredStage(
        "frame",
        "The whole frame: quality and size",
        _FRAME,
        "quality reference at the plate's own size: radiance where the whale or its shadow is, enlarged linearly",
        of(1.0, 0.75, 0.5, 0.25),
        of(0.5)[:2],
        qualities("draw.quality", "plate.scale"),
        lambda bench: frames_against(bench, {"draw.quality": "reference", "plate.scale": 1.0}),
    )


def _open_light(bench: Workbench) -> Workload:
    import cv2

    images = [plate.image_linear for plate in bench.plates]

    def prepare(knobs: Knobs) -> Callable[[int], Any]:
        height, width = (round(side * knobs["plate.scale"]) for side in images[0].shape[:2])
        small = [cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA) for image in images]
        return lambda k: environment(small[k], underwater=True)

    truth = environment(images[0], underwater=True).irradiance
    return prepare, lambda light: relative_rms(light.irradiance, truth)


def frames_against(bench: Workbench, finest: Knobs) -> Workload:
    """Return the workload of whole frames; finest: settings of the truth. Its error is taken where that has a layer."""
    best = bench.frames(finest)(0)
    truth = picture_of(best)
    touched = np.any(truth != best.plate.image_linear, axis=-1)

    def error(frame: Any) -> float:
        return relative_rms(_as_large(picture_of(frame), truth)[touched], truth[touched])

    return bench.frames, error


def _as_large(image: Floats, like: Floats) -> Floats:
    """Return a picture (h, w, 3) enlarged linearly to the size of another; itself where it has that size."""
    import cv2

    if image.shape == like.shape:
        return image
    return np.asarray(cv2.resize(image, like.shape[1::-1], interpolation=cv2.INTER_LINEAR))
