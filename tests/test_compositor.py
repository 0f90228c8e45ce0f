# SPDX-License-Identifier: Apache-2.0
"""Single frames by library calls: a scene that is loaded once, and what a clip's analysis gives to its frames."""

from __future__ import annotations

import functools
import gc
import json
import threading
import weakref
from pathlib import Path

import moderngl
import numpy as np
import OpenEXR
import pytest

import mr360uw as uw
from mr360uw.base.color import encode
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.gl import gl_context
from mr360uw.medium.medium import Medium
from mr360uw.medium.models import FieldModel
from mr360uw.render.loaded import Loaded
from mr360uw.sample import SampleDive
from mr360uw.types import Floats
from tests.tolerances import FRAME_ALONE_CODES, FRAME_ALONE_FRACTION


def codes(linear: Floats) -> Floats:
    return np.round(255.0 * encode(np.clip(linear, 0.0, 1.0), "srgb"))


def test_frames_of_a_clip_are_those_that_a_composite_writes(dive: SampleDive, tmp_path: Path, backend: str) -> None:
    scene = uw.load_scene(dive.scene)
    told = tmp_path / "run.json"
    uw.composite_video(scene, tmp_path / "out_%d.exr", frames=(2, 5), backend=backend, report=told)
    table = json.loads(told.read_text("utf-8"))
    assert (uw.Scene(**table["scene"]), table["seeds"]) == (scene, {"sea": scene.sea.seed})
    assert table["packages"]["numpy"] == np.__version__
    analysis = uw.analyse_clip(dive.plate, scene)
    with uw.open_video(dive.plate) as video, uw.Compositor(scene, backend=backend, analysis=analysis) as compositor:
        found = [result.image_linear for result in compositor.frames(2, 5)]
        # the light of most frames of a clip is that of frames before and after, here that of the frame alone
        alone = [compositor.frame(frame).image_linear for frame in video.frames(2, 5)]
    header = OpenEXR.File(str(tmp_path / "out_2.exr")).header()
    assert header["frameNumber"] == 2
    assert (header["framesPerSecond"], header["timeCode"].frame) == (24, 2)
    with uw.open_video(tmp_path / "out_%d.exr") as written:
        for frame, in_clip, by_itself in zip(written.frames(), found, alone, strict=True):
            np.testing.assert_array_equal(in_clip.astype(np.float16), frame.image_linear.astype(np.float16))
            off = np.abs(codes(by_itself) - codes(in_clip)).max(axis=-1)
            assert np.mean(off <= FRAME_ALONE_CODES) >= FRAME_ALONE_FRACTION


def test_a_scene_is_loaded_once(dive: SampleDive, tmp_path: Path) -> None:
    mesh = tmp_path / "whale.glb"
    mesh.write_bytes(dive.mesh.read_bytes())
    scene = uw.load_scene(dive.scene)
    scene = scene.model_copy(update={"objects": (scene.objects[0].model_copy(update={"mesh": mesh}),)})
    plate = np.full((64, 128, 3), 0.2, np.float32)
    with uw.Compositor(scene, backend="reference") as compositor:
        compositor.frame(plate, 0.0)
        mesh.unlink()
        later = compositor.frame(plate, 0.5).image_linear
    mesh.write_bytes(dive.mesh.read_bytes())
    np.testing.assert_array_equal(later, uw.render_frame(plate, scene, 0.5, "reference").image_linear)


def test_frames_of_another_size_follow(dive: SampleDive) -> None:
    scene = uw.load_scene(dive.scene)
    with uw.Compositor(scene, backend="reference") as compositor:
        for height in (32, 64):
            plate = np.full((height, 2 * height, 3), 0.2, np.float32)
            assert compositor.frame(plate).image_linear.shape == plate.shape


def test_any_thread_may_close_it(dive: SampleDive) -> None:
    compositor = uw.Compositor(uw.load_scene(dive.scene), backend="reference")
    other = threading.Thread(target=compositor.close)
    other.start()
    other.join()
    with pytest.raises(uw.ParameterError, match="compositor - is closed"):
        compositor.frame(np.full((32, 64, 3), 0.2, np.float32))


def test_nothing_of_a_closed_compositor_stays(dive: SampleDive, backend: str) -> None:
    """Nothing waits for the garbage collector either, which counts objects and not their size."""
    scene, plate = uw.load_scene(dive.scene), np.full((32, 64, 3), 0.2, np.float32)
    of_scene: tuple[type, ...] = (Loaded, Mesh, Medium, FieldModel)
    on_device = (moderngl.Buffer, moderngl.Framebuffer, moderngl.Program, moderngl.Texture, moderngl.VertexArray)
    uw.render_frame(plate, scene, backend=backend)  # what is made once in a process
    gc.unfreeze()  # what was made before the first test counts
    gc.collect()
    before, of_others = [alive(kind) for kind in (*of_scene, *on_device)], limited_results()
    gc.disable()
    try:
        compositor = uw.Compositor(scene, backend=backend)
        result = compositor.frame(plate)
        assert result.medium is not None
        refs = [weakref.ref(array) for array in (result.image_linear, result.medium.veil)]
        open_ = [alive(kind) for kind in (*of_scene, *on_device)]
        assert all(now > then for now, then in zip(open_[:4], before[:4], strict=True))
        assert limited_results() > of_others
        compositor.close()
        del result
        after = [alive(kind) for kind in (*of_scene, *on_device)]
        assert all(now <= then for now, then in zip(after, before, strict=True)), (before, open_, after)
        assert [ref() for ref in refs] == [None] * len(refs)
        assert limited_results() == of_others
        assert backend != "gl" or not gl_context().objects  # of these the device would be freed by the next frame
    finally:
        gc.enable()


def alive(kind: type) -> int:
    return sum(issubclass(type(one), kind) for one in gc.get_objects())  # isinstance would ask proxies of what is gone


def limited_results() -> int:
    """Return how many results the physics keeps of functions that keep a limited number of them."""
    rooms = tuple(f"mr360uw.{room}." for room in ("medium", "caustics", "composite"))
    functions = [one for one in gc.get_objects() if type(one) is functools._lru_cache_wrapper]
    found = [one.cache_info() for one in functions if one.__module__.startswith(rooms)]
    return sum(info.currsize for info in found if info.maxsize is not None)
