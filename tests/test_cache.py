# SPDX-License-Identifier: Apache-2.0
"""Results kept between frames: found by the function and its inputs, and that nothing else decides them."""

from __future__ import annotations

import gc
import weakref
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.base.cache import Cache, PartOf, Parts, by_content, name_of
from mr360uw.render.check import StageGraph
from mr360uw.render.first_pass import ClipAnalysis
from mr360uw.render.frame import composite_frame, make_backend
from mr360uw.render.loaded import Loaded, load
from mr360uw.types import Layer
from mr360uw.video import VideoFrame
from tests.scenes import gradient_plate, scene_with


@dataclass(frozen=True, eq=False)
class Place(Parts):
    at: np.ndarray
    name: str


def doubled(letter: str) -> list[str]:
    return [letter, letter]


def placed(place: Place, array: Any) -> list[object]:
    return [place, array]


def name_in(place: PartOf[Place]) -> str:
    return place.whole.name


def emptying(cache: Cache, letter: str) -> list[str]:
    cache.drop(emptying)
    return [letter]


class Painter:
    def paint(self, letter: str) -> list[str]:
        return [letter]


def test_the_last_results_of_a_function_are_kept() -> None:
    cache = Cache()
    first = cache.of(doubled, "a")
    assert cache.of(doubled, "a") is first
    assert cache.of(doubled, "b") == ["b", "b"]
    assert cache.of(doubled, "a") is not first
    two = [cache.of(doubled, letter, keep=2) for letter in "ab"]
    assert all(cache.of(doubled, letter, keep=2) is one for letter, one in zip("ab", two, strict=True))
    assert cache.holds(doubled, "a")
    cache.drop(doubled, "a")
    assert not cache.holds(doubled, "a")
    assert cache.holds(doubled, "b")
    cache.clear()
    assert not cache.holds(doubled, "b")
    roomy = Cache(room=2)
    found = [roomy.of(doubled, letter) for letter in "ab"]
    assert [roomy.of(doubled, letter) for letter in "ab"] == found
    assert roomy.made == {"doubled": 2}


def test_a_result_whose_making_drops_its_function_is_kept() -> None:
    cache = Cache(room=2)
    first = cache.of(emptying, cache, "a")
    assert cache.of(emptying, cache, "a") is first
    assert cache.of(emptying, cache, "b") == ["b"]
    assert not cache.holds(emptying, cache, "a")


def test_a_function_within_another_is_refused() -> None:
    """It may depend on more than its inputs."""
    with pytest.raises(TypeError, match="more than its inputs"):
        Cache().of(lambda letter: letter, "a")


def test_what_counts_of_an_input() -> None:
    """Small arrays and the fields of what is assembled anew count by value, large arrays by identity."""
    cache, large = Cache(), np.zeros(1 << 18)
    result = cache.of(placed, Place(np.arange(3.0), "a"), large)
    assert cache.of(placed, Place(np.arange(3.0), "a"), large) is result
    assert cache.of(placed, Place(np.arange(3.0), "b"), large) is not result
    assert cache.of(placed, Place(np.arange(3.0) + 1.0, "a"), large) is not result
    result = cache.of(placed, Place(np.arange(3.0), "a"), large)
    assert cache.of(placed, Place(np.arange(3.0), "a"), large.copy()) is not result
    by_value = cache.of(placed, Place(np.arange(3.0), "a"), by_content(large))
    assert cache.of(placed, Place(np.arange(3.0), "a"), by_content(large.copy())) is by_value
    assert cache.of(placed, Place(np.arange(3.0), "a"), by_content(large + 1.0)) is not by_value
    part = PartOf(Place(np.arange(3.0), "a"), "a")
    of_part = cache.of(placed, Place(np.zeros(1), "c"), part)
    assert cache.of(placed, Place(np.zeros(1), "c"), PartOf(Place(np.zeros(3), "other"), "a")) is of_part
    assert cache.of(placed, Place(np.zeros(1), "c"), PartOf(part.whole, "other")) is not of_part


def test_of_an_input_in_part_the_rest_is_not_kept() -> None:
    cache, whole = Cache(), Place(np.arange(3.0), "a")
    gone = weakref.ref(whole)
    cache.of(name_in, PartOf(whole, whole.name))
    del whole
    assert gone() is None
    assert cache.holds(name_in, PartOf(Place(np.zeros(1), "a"), "a"))


def test_a_method_counts_by_its_object_and_does_not_keep_it() -> None:
    cache, one, two = Cache(), Painter(), Painter()
    first = cache.of(one.paint, "a", keep=2)
    assert cache.of(two.paint, "a", keep=2) is not first
    assert cache.of(one.paint, "a", keep=2) is first
    gone = weakref.ref(one)
    del one
    assert gone() is None
    assert all(cache.of(Painter().paint, "a", keep=4) is not first for _ in range(64))  # may stand where one stood


# --- frames ---------------------------------------------------------------------------------------------------------


class Recomputing(Cache):
    """A cache that calls a function again where its result is there, and compares: no input may be left out."""

    def __init__(self, room: int = 1) -> None:
        super().__init__(room)
        self.compared: set[str] = set()

    def of(self, function: Any, *inputs: Any, keep: int = 1) -> Any:
        there = self.holds(function, *inputs)
        result = super().of(function, *inputs, keep=keep)
        if there and same(result, result):  # of kinds that can be compared
            assert same(function(*inputs), result), name_of(function)
            self.compared.add(name_of(function))
        return result


def same(one: Any, two: Any) -> bool:
    """Return whether two results hold the same numbers; of other kinds False."""
    if isinstance(one, np.ndarray):
        return isinstance(two, np.ndarray) and np.array_equal(one, two, equal_nan=one.dtype.kind == "f")
    if isinstance(one, tuple | list):
        return len(one) == len(two) and all(map(same, one, two))
    if isinstance(one, Layer) and one.ground is not None:
        return isinstance(two, Layer) and same(one.laid(), two.laid())
    if is_dataclass(one):
        return type(one) is type(two) and all(same(getattr(one, f.name), getattr(two, f.name)) for f in fields(one))
    return isinstance(one, int | float | str | np.generic | None) and one == two


@pytest.fixture
def rich(tmp_path: Path, whale: Path) -> Loaded:
    """A scene with bodies at rest and in motion, a floor, a lamp, caustics and shafts, for frames of 128 x 64."""
    keys = [{"time_s": 0.0}, {"time_s": 0.1, "position_m": [0.5, -0.4, -2.5]}, {"time_s": 9.0}]
    tables = {
        "object": [
            {"mesh": str(whale), "position_m": [0.3, -0.4, -3.0]},
            {"mesh": str(whale), "position_m": [-0.6, -0.9, -2.0], "scale": 0.3, "key": keys},
        ],
        "receiver": {"height_m": -1.6, "caustics": True},
        "lamp": [{"attach": "camera", "rotation_deg": [0.0, -20.0, 0.0], "lumen": 20000.0}],
        "caustics": {"size": 64, "grid": 32, "planes": 2},
        "shafts": {"resolution": 32, "slices": 16},
        "light": {"sun": "given", "sun_azimuth_deg": 20.0, "sun_elevation_deg": 70.0},
        "draw": {"samples": 1, "sun_samples": 2, "motion_samples": 2},
        "water": {"bands": 4},
    }
    return load(scene_with(tmp_path, None, rough=True, **tables), 128, 64, clip=False)


def plates(count: int) -> list[VideoFrame]:
    """Return frames of which two at a time show the same instant."""
    return [VideoFrame.of_linear(gradient_plate(128, 64), k, 0.05 * (k // 2)) for k in range(count)]


@pytest.mark.usefixtures("gl")
def test_a_cache_that_is_dropped_changes_no_code(rich: Loaded) -> None:
    backend, _ = make_backend("gl")

    def run(frames: list[VideoFrame]) -> np.ndarray:
        backend.cache.clear()
        made = [composite_frame(rich, ClipAnalysis(), backend, plate, 0.02) for plate in frames]
        return np.stack([frame.picture.image_linear for frame in made])

    whole = run(plates(3))
    assert np.ptp(whole, axis=0).max() > 0.01
    # from the second of two frames of an instant on: it finds nothing, and the third what the second left
    assert np.array_equal(whole[1:], run(plates(3)[1:]))


@pytest.mark.parametrize("name", ["reference", "gl"])
def test_a_stage_depends_on_nothing_but_its_inputs(rich: Loaded, name: str, request: pytest.FixtureRequest) -> None:
    """Whatever is found again is what the function returns now, of every stage whose results can be compared."""
    if name == "gl":
        request.getfixturevalue("gl")
    cache = Recomputing(2)
    backend, _ = make_backend(name, Recomputing(2))
    for plate in plates(1 if name == "reference" else 3):
        for _ in range(2):
            composite_frame(rich, ClipAnalysis(), backend, plate, 0.0, cache=cache)
    assert {"draw_layer", "plate_light"} <= cache.compared
    assert backend.cache.compared


def test_a_frame_leaves_nothing_behind(rich: Loaded) -> None:
    """A cache is gone with its last user, without the garbage collector, which does not count bytes."""
    gc.collect()
    gc.disable()
    try:
        cache, (plate, *_) = Cache(), plates(1)
        backend, _ = make_backend("reference")
        composite_frame(rich, ClipAnalysis(), backend, plate, 0.0, cache=cache)
        gone = weakref.ref(cache), weakref.ref(backend.cache)
        del cache, backend
        assert [one() for one in gone] == [None, None]
    finally:
        gc.enable()


def test_the_graph_of_a_frame_names_its_stages_and_whom_they_follow(rich: Loaded) -> None:
    graph = StageGraph()
    backend, _ = make_backend("reference", StageGraph(graph=graph))
    (plate,) = plates(1)
    composite_frame(rich, ClipAnalysis(), backend, plate, 0.0, cache=graph)
    assert "plate_light" in graph.runs["exposed_water"].inputs
    assert {"exposed_water", "turned"} <= graph.runs["draw_layer"].inputs
    assert {"plate_light", "exposed_water", "draw_layer", "VideoFrame.over"} <= graph.runs.keys()
    assert all(run.ran == run.asked == 1 for name, run in graph.runs.items() if name in ("plate_light", "draw_layer"))
    assert "draw_layer" in str(graph)
    before = graph.runs["draw_layer"].seconds
    assert before > 0.0
    graph.forget_times()
    composite_frame(rich, ClipAnalysis(), backend, plate, 0.0, cache=graph)
    assert graph.runs["draw_layer"].ran == 0
    assert graph.runs["draw_layer"].asked == 1
