# SPDX-License-Identifier: Apache-2.0
"""Frames of a scene that changes: what is run again, and that it is what a fresh start gives."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from mr360uw.base.cache import name_of
from mr360uw.errors import MeshError, Mr360uwError, VideoError
from mr360uw.preview.live import LivePreview, coarse
from mr360uw.preview.screen import screen_codes, screen_picture
from mr360uw.render.first_pass import clip_analysis
from mr360uw.render.frame import composite_frame, make_backend
from mr360uw.render.loaded import load
from mr360uw.sample import sample_dive
from mr360uw.scene.model import Scene, load_scene
from mr360uw.scene.resolved import open_plate
from mr360uw.video import VideoFrame

FEW = (
    "light.sun=given",
    "draw.samples=1",
    "draw.sun_samples=2",
    "caustics.size=32",
    "caustics.grid=32",
    "water.bands=8",
)
"""Settings that make a frame cheap, and a sun that every frame has."""


@pytest.fixture(scope="module")
def small_dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scene file of a dive of four frames, 128x64."""
    return sample_dive(tmp_path_factory.mktemp("small dive"), width=128, frames=4).scene


@pytest.fixture(scope="module")
def kept(small_dive: Path) -> Iterator[LivePreview]:
    """A preview that has shown a frame of the dive, by the reference renderer."""
    with LivePreview("reference") as live:
        live.frame(load_scene(small_dive, FEW), 0)
        yield live


def codes(frame: VideoFrame) -> list[np.ndarray]:
    planes = frame.yuv
    return [frame.image_linear] if planes is None else [planes.y, planes.u, planes.v]


def same(one: VideoFrame, other: VideoFrame) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(codes(one), codes(other), strict=True))


# --- what is run -------------------------------------------------------------------------------------------------


def test_a_change_leaves_alone_what_does_not_depend_on_it(small_dive: Path, subtests: pytest.Subtests) -> None:
    """What is slow of a frame: a control is followed at once where it is not made again."""
    with LivePreview("reference") as kept:
        caustics = name_of(kept.backend.caustics)
        slow = {"solved", "plate_light", "exposed_water", "PlatePattern", caustics, "draw_layer"}
        for change, touched in (
            ("output.quality=20", set()), ("draw.grain=0.5", set()),
            ("object.0.base_color=[0.5, 0.2, 0.1]", {"draw_layer"}),
            ("light.exposure=0.5", {"draw_layer"}), ("sea.wind_speed=6", {caustics, "draw_layer"}),
            ("light.peak=9", {"plate_light", "exposed_water", "draw_layer"}),
        ):  # fmt: skip
            kept.frame(load_scene(small_dive, FEW), 0)
            before = kept.made.copy()
            kept.frame(load_scene(small_dive, (*FEW, change)), 0)
            with subtests.test(change):
                assert slow & set(kept.made - before) == touched


# --- that it is right ----------------------------------------------------------------------------------------------

CHANGES = (
    ("draw.grain=0.8", "object.0.scale=1.4", "draw.sun_spread_deg=7"),
    ("object.0.rotation_deg=[20, 0, 0]", "object.0.base_color=[0.5, 0.2, 0.1]"),
    ("object.0.casts_shadow=false", "draw.shutter=0.1"),
    ("light.sun_azimuth_deg=20", "caustics.sun_half_angle_rad=0.02"),
    ("water.type=3C", "light.sun=detect", "light.peak=9"),
    ("water.gain=[0.4, 0.5, 0.5]",),
    ("sea.wind_speed=7", "receiver.height_m=-2.5"),
    ("camera.depth_m=7", "camera.pitch_deg=10"),
    ("object.0.position_m=[0.2, 0.1, -3]", "receiver.shadow=false", "lamp=[{attach='camera'}]"),
    ("water.type=none", "draw.ambient_occlusion=false"),
)


def test_what_is_kept_changes_nothing(small_dive: Path, backend: str) -> None:
    """Changes that come and go in random order, drafts between them, give the frames of a fresh start, exactly."""
    rng = np.random.default_rng(len(backend))
    order = rng.permutation(len(CHANGES))
    few = FEW if backend == "reference" else (*FEW, "water.rough=true")
    with LivePreview(backend) as live:
        for step in range(6):  # none, and all by two
            chosen = [change for k in order[2 * step - 2 : 2 * step] for change in CHANGES[k]] if step else []
            scene, index = load_scene(small_dive, (*few, *chosen)), int(rng.integers(4))
            live.frame(coarse(scene), index, 64)
            shown = live.frame(scene, index)
            with LivePreview(backend) as fresh:
                assert same(shown.picture, fresh.frame(scene, index).picture), chosen


def test_it_shows_what_frames_are_made_of(kept: LivePreview, small_dive: Path) -> None:
    scene = load_scene(small_dive, FEW)
    with open_plate(scene) as video:
        loaded = load(scene, video.width, video.height)
        analysis, plate = clip_analysis(loaded, video), next(iter(video.frames(2, 3)))
    composed = composite_frame(loaded, analysis, make_backend("reference")[0], plate, 0.0).picture
    alone = kept.frame(scene, 2).picture
    assert analysis.gain is not None
    kept.measure(scene)
    assert same(kept.frame(scene, 2).picture, composed)
    draft = kept.frame(coarse(scene), 2).light
    assert draft is not None
    assert np.array_equal(draft.gain, analysis.gain_at(2)), "drafts use them"
    assert not same(alone, composed)
    other = load_scene(small_dive, (*FEW, "light.peak=9"))
    with LivePreview("reference") as fresh:
        assert same(kept.frame(other, 2).picture, fresh.frame(other, 2).picture), "the analysis is of other light"


def test_drafts_look_like_frames(kept: LivePreview, small_dive: Path) -> None:
    """Less the detail of one pixel of a draft, which is blurred away."""
    scene = load_scene(small_dive)
    whole = kept.frame(scene, 0).picture.image_linear
    draft = kept.frame(coarse(scene), 0).picture.image_linear
    off = np.abs(cv2.GaussianBlur(whole, (0, 0), 2.0) - cv2.GaussianBlur(draft, (0, 0), 2.0))
    assert off.mean() < 0.2 / 255.0
    assert np.quantile(off, 0.999) < 6.0 / 255.0


# --- errors and files ------------------------------------------------------------------------------------------------


def test_a_draft_may_hold_the_plates_light(small_dive: Path, subtests: pytest.Subtests) -> None:
    """To solve it anew for other water takes most of a draft, and changes it little."""
    sharp = *FEW, "water.blur=false"  # its cells are as large as the bodies of so small a plate
    scene = load_scene(small_dive, sharp)
    with LivePreview("reference") as live:
        live.frame(scene, 0)
        for change in ("water.visibility_m=12", "receiver.height_m=-2.7"):
            with subtests.test(change):
                changed = load_scene(small_dive, (*sharp, change))
                before = live.made["plate_light"]
                held = live.frame(changed, 0, holds_light=True)
                assert live.made["plate_light"] == before
                whole = live.frame(changed, 0)
                assert live.made["plate_light"] == before + 1
                shown = np.any(whole.picture.image_linear != whole.plate.image_linear, axis=-1)
                assert np.count_nonzero(shown) > 100
                one, other = (screen_codes(frame.picture.image_linear)[shown].astype(int) for frame in (held, whole))
                assert np.abs(one - other).mean() < 2.0  # of codes that change by tens; .2 to 1 on plates of 1024
                live.frame(scene, 0)
        # Of another frame, or in other light, there is none to hold
        for index, changed in ((1, scene), (0, load_scene(small_dive, (*sharp, "light.exposure=0.5")))):
            whole = live.frame(changed, index)
            live.frame(scene, 0)
            assert same(live.frame(changed, index, holds_light=True).picture, whole.picture)


def test_it_works_on_after_errors(small_dive: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(small_dive.parent, tmp_path / "dive")
    scene = load_scene(folder / small_dive.name, FEW)
    with LivePreview("reference") as live:
        before = live.frame(scene, 0).picture
        with pytest.raises(VideoError):
            live.frame(scene, 99)
        with pytest.raises(Mr360uwError):
            live.frame(scene, 0, width=8)
        mesh = folder / "whale.glb"
        good = mesh.read_bytes()
        mesh.write_bytes(b"no mesh")
        with pytest.raises(MeshError):
            live.frame(scene, 0)
        mesh.write_bytes(good)
        assert same(live.frame(scene, 0).picture, before)


def test_changed_files_are_read_again(small_dive: Path, tmp_path: Path) -> None:
    shown = np.full((64, 128, 3), 90, np.uint8)
    plate, matte = tmp_path / "plate.png", tmp_path / "matte.png"
    cv2.imwrite(str(plate), shown)
    cv2.imwrite(str(matte), np.zeros((64, 128), np.uint8))
    whale = small_dive.parent / "whale.glb"
    scene = Scene.model_validate(
        {"plate": plate, "object": [{"mesh": whale, "position_m": (0.4, -0.6, -3.6)}], "holdout": [{"path": matte}]}
        | {"draw": {"samples": 1, "sun_samples": 1, "ambient_occlusion": False}}
    )
    with LivePreview("reference") as live:
        first = live.frame(scene, 0)
        assert live.frame(scene, 0).picture is first.picture
        assert live.plates.reader(scene).frame_count is None
        cv2.imwrite(str(matte), np.full((64, 128), 255, np.uint8))
        hidden = live.frame(scene, 0)
        assert hidden.plate is first.plate
        assert np.array_equal(hidden.picture.rgb, first.plate.rgb)
        cv2.imwrite(str(plate), np.minimum(shown + 40, 255))
        assert np.all(live.frame(scene, 0).picture.rgb == 130)


# --- the plate -------------------------------------------------------------------------------------------------------


def test_plate_and_thumbnails(kept: LivePreview, small_dive: Path) -> None:
    scene = load_scene(small_dive, FEW)
    clip = kept.plates.reader(scene)
    assert (clip.frame_count, clip.width, clip.height) == (4, 128, 64)
    with open_plate(scene) as video:
        frames = list(video.frames())
    for index in (3, 0, 2, 1, 3):
        assert same(kept.plates.at(scene, index), frames[index])
    small = kept.plates.at(scene, 2, 64)
    assert small.shape == (32, 64)
    assert small.index == 2
    with LivePreview("reference") as live:
        assert [live.plates.soonest(scene, index, None) for index in (0, 3)] == [0, 3], "near ones are decoded at once"
    shown = kept.plates.overview(scene, 3, 64)
    assert [frame.index for frame in shown] == sorted({frame.index for frame in shown})
    assert shown[0].index == 0
    assert all(frame.shape == (32, 64) for frame in shown)


def test_a_preview_that_was_closed_starts_anew(small_dive: Path) -> None:
    scene = load_scene(small_dive, FEW)
    live = LivePreview("reference")
    first = live.plates.at(scene, 1)
    live.close()
    live.close()
    assert same(live.plates.at(scene, 1), first)
    assert live.plates.at(scene, 1) is not first


def test_pictures_for_a_screen(rng: np.random.Generator) -> None:
    light = rng.uniform(-0.1, 1.2, (32, 64, 3)).astype(np.float32)
    clipped = np.clip(light, 0.0, 1.0).astype(np.float64)
    exact = 255.0 * np.where(clipped < 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    assert np.max(np.abs(screen_codes(light) - exact)) < 0.55  # rounding, and half a step of the table
    png = cv2.imdecode(np.frombuffer(screen_picture(light, ".png"), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    np.testing.assert_array_equal(png, screen_codes(light))
    smooth = cv2.GaussianBlur(light, (0, 0), 4.0)
    jpeg = cv2.imdecode(np.frombuffer(screen_picture(smooth), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert np.abs(jpeg.astype(int) - screen_codes(smooth)).mean() < 3.0  # chroma of JPEG is halved
    assert screen_picture(light, width=16)[:2] == b"\xff\xd8"
