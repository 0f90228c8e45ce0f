# SPDX-License-Identifier: Apache-2.0
"""Values kept between frames, and that dropping them changes nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mr360uw.cache import Cache, Same
from mr360uw.render.backends import make_backend
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import finished, frame_stages
from mr360uw.render.loaded import load
from mr360uw.video import VideoFrame
from tests.scenes import gradient_plate, scene_with


def test_the_last_values_of_a_name_are_kept() -> None:
    cache, made = Cache(), []

    def make(key: str) -> str:
        made.append(key)
        return key

    for key in "aabab":
        assert cache.get("letter", key, lambda key=key: make(key)) == key
    assert made == ["a", "b", "a", "b"]
    for key in "aba":
        cache.get("two", key, lambda key=key: make(key), keep=2)
    assert made[4:] == ["a", "b"]
    cache.drop("two")
    cache.get("two", "a", lambda: make("a"), keep=2)
    cache.clear()
    cache.get("letter", "b", lambda: make("b"))
    assert made[6:] == ["a", "b"]


def test_values_of_several_keys_are_made_together() -> None:
    cache, made = Cache(), []

    def make(keys: list[str]) -> list[str]:
        made.append("".join(keys))
        return [key.upper() for key in keys]

    assert cache.get_all("letter", "abca", make, keep=3) == ["A", "B", "C", "A"]
    assert cache.get_all("letter", "cdb", make, keep=3) == ["C", "D", "B"]
    assert cache.get_all("letter", "bdc", make, keep=3) == ["B", "D", "C"]
    assert cache.get_all("letter", "efghe", make, keep=2) == ["E", "F", "G", "H", "E"]  # more than are kept
    assert made == ["abc", "d", "efgh"]


def test_a_value_whose_making_drops_its_name_is_kept() -> None:
    cache, made = Cache(room=2), []

    def make(key: str) -> str:
        cache.drop("letter")
        made.append(key)
        return key

    for key in "aabbab":
        cache.get("letter", key, lambda key=key: make(key))
    assert made == ["a", "b", "a", "b"]


def test_arrays_are_keys_by_identity() -> None:
    a, b = np.zeros(3), np.zeros(3)
    assert Same(a) == Same(a)
    assert Same(a) != Same(b)
    assert hash(Same(a)) == hash(Same(a))


@pytest.mark.usefixtures("gl")
def test_a_cache_that_is_dropped_at_random_changes_no_code(
    tmp_path: Path, whale: Path, rng: np.random.Generator
) -> None:
    keys = [{"time_s": 0.0}, {"time_s": 0.1, "position_m": [0.5, -0.4, -2.5]}, {"time_s": 9.0}]
    tables = {
        "object": [
            {"mesh": str(whale), "position_m": [0.3, -0.4, -3.0]},
            {"mesh": str(whale), "position_m": [-0.6, -0.9, -2.0], "scale": 0.3, "key": keys},
        ],
        "receiver": {"height_m": -1.6, "caustics": True},
        "lamp": [{"attach": "camera", "rotation_deg": [0.0, -20.0, 0.0], "lumen": 20000.0}],
        "caustics": {"size": 64, "grid": 32, "planes": 2},
    }
    loaded = load(scene_with(tmp_path, None, **tables), 128, 64, clip=False)
    plates = [VideoFrame.of_linear(gradient_plate(128, 64), k, 0.05 * (k // 2)) for k in range(8)]
    pictures = []
    for drops in (False, True):
        backend, _ = make_backend("gl")
        run = []
        for plate in plates:
            if drops and rng.random() < 0.5:
                backend.cache.clear()
            run.append(finished(frame_stages(loaded, ClipAnalysis(), backend, plate, 0.02)).picture.image_linear)
        pictures.append(np.stack(run))
    assert np.ptp(pictures[0], axis=0).max() > 0.01
    assert np.array_equal(pictures[0], pictures[1])
