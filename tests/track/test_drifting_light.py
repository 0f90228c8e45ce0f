# SPDX-License-Identifier: Apache-2.0
"""Light that drifts over a floor as a rigid pattern, and paths that follow it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import mr360uw as uw
from benchmarks.tracks import RATE, Clip, slips
from mr360uw.base.sphere import directions
from mr360uw.sample.dive import record
from mr360uw.track.slip import drifting_layer, drifting_light
from mr360uw.track.tracking import report_lines, verdict

WIDTH, TIMES = 512, np.arange(12) / 6.0
DRIFT = np.array([0.12, -0.08])
"""Drift of the light [heights/s] over x and z."""
EYES = np.column_stack([0.1 * np.sin(TIMES), np.ones(12), -0.2 * TIMES])
TURNS = np.repeat(np.eye(3)[None], 12, axis=0)


def smooth(rng: np.random.Generator, size: float) -> np.ndarray:
    """Return noise of 8 by 8 heights, 512 cells, of deviation 1."""
    noise = cv2.GaussianBlur(np.tile(rng.normal(size=(512, 512)), (2, 2)), (0, 0), size)[256:768, 256:768]
    return (noise - noise.mean()) / noise.std()


def caustics(rng: np.random.Generator) -> np.ndarray:
    """Return bright lines on a dark ground, mean 1."""
    light = cv2.GaussianBlur(1.0 / (0.15 + np.abs(smooth(rng, 9.0))), (0, 0), 2.0)
    return light / light.mean()


def sampled(pattern: np.ndarray, x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return a pattern at places [heights]."""
    at = [(64.0 * v).astype(np.float32) % 511.0 for v in (x, z)]
    return cv2.remap(pattern.astype(np.float32), *at, cv2.INTER_LINEAR)


def seen(albedo: np.ndarray, light: list[np.ndarray], raised: np.ndarray | None = None) -> list[np.ndarray]:
    """Return the codes of a floor under light that drifts; what is raised lies a quarter of a height above it."""
    pictures = []
    for eye, time_s, lit in zip(EYES, TIMES, light, strict=True):
        ray = directions(WIDTH, WIDTH // 2)
        away = 1.0 / np.maximum(-ray[..., 1], 0.05)
        x, z = (eye[k] + away * ray[..., k] for k in (0, 2))
        grey = sampled(albedo, x, z) * sampled(lit, x - DRIFT[0] * time_s, z - DRIFT[1] * time_s)
        if raised is not None:
            up = [eye[k] + 0.75 * away * ray[..., k] for k in (0, 2)]
            grey = np.where(sampled(raised, *up) > 0.5, sampled(albedo, *up), grey)
        pictures.append(np.clip(90.0 * grey, 0.0, 255.0).astype(np.uint8))
    return pictures


def layer(pictures: list[np.ndarray], eyes: np.ndarray = EYES) -> tuple[np.ndarray, float]:
    """Return what drifts over the floor, by a path."""
    return drifting_layer(pictures, np.full(pictures[0].shape, 255, np.uint8), TIMES, eyes, TURNS)


def test_light_is_told_from_the_floor_whichever_the_path_holds_still(rng: np.random.Generator) -> None:
    pictures = seen(1.0 + 0.2 * smooth(rng, 1.0), [caustics(rng)] * 12)
    # a cell in two seconds is 0.012 heights/s
    drift, light = layer(pictures)
    np.testing.assert_allclose(drift, DRIFT, atol=0.012)
    assert 0.75 < light < np.inf
    carried = EYES - np.insert(np.outer(TIMES, DRIFT), 1, 0.0, axis=1)
    drift, light = layer(pictures, carried)
    np.testing.assert_allclose(drift, -DRIFT, atol=0.012)
    assert light < -0.75


def test_light_that_changes_drifts_nowhere(rng: np.random.Generator) -> None:
    _, light = layer(seen(1.0 + 0.2 * smooth(rng, 1.0), [caustics(rng) for _ in TIMES]))
    assert light == np.inf


def test_two_levels_of_a_floor_are_no_drift(rng: np.random.Generator) -> None:
    """By parallax the upper one drifts evenly, against the way of the camera."""
    albedo, raised = 1.0 + 0.2 * smooth(rng, 1.0), (smooth(rng, 24.0) > 0.5).astype(np.float64)
    assert layer(seen(albedo, [np.ones((512, 512))] * 12, raised))[1] == np.inf


def test_what_cannot_be_told_from_the_floor_is_doubted(rng: np.random.Generator, tmp_path: Path) -> None:
    """Of two patterns that are alike, either may be the light: the path stays, and may have been carried along."""
    pictures = seen(1.0 + 0.2 * smooth(rng, 1.0), [1.0 + 0.2 * smooth(rng, 1.0)] * 12)
    paths = tuple(tmp_path / f"{k}.png" for k in range(13))
    for path, picture in zip(paths, [*pictures, np.full(pictures[0].shape, 255, np.uint8)], strict=True):
        cv2.imwrite(str(path), picture)
    points = np.insert(rng.uniform(-2.0, 2.0, (200, 2)), 1, 0.0, axis=1)
    away, unsure, drifts = drifting_light(paths[:12], paths[12], np.arange(12), TIMES, (EYES, TURNS), points)
    assert not away.any()
    assert not drifts
    np.testing.assert_allclose(unsure, np.insert(np.outer(TIMES, DRIFT), 1, 0.0, axis=1), atol=0.02)


def test_a_path_that_light_carried_along_is_freed(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    clip, times = Clip.of(14, texture=0.5), np.arange(26) / float(RATE)
    record(tmp_path / "clip.mp4", (clip.see(512, t, samples=1)[0] for t in times), RATE, seed=1)
    track = uw.track_camera(tmp_path / "clip.mp4", height_m=clip.height_m)
    # it drifts by 0.24 m/s for 1.04 s; a cell is 4 cm
    assert track.light_m == pytest.approx(0.25, abs=0.04)
    poses = [clip.pose(t) for t in times]
    true = np.array([p for p, _ in poses]), np.array([r for _, r in poses])
    # carried along, it slips by 10 cm
    assert np.sqrt(np.mean(np.square(slips((track.position, track.rotation), true, clip.height_m)))) < 0.02
    assert verdict(track).startswith("usable")
    assert any(line.startswith("light") for line in report_lines(track))
