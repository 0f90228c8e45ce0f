# SPDX-License-Identifier: Apache-2.0
"""A clip of high dynamic range goes in, one comes out: light above white, curve, primaries and metadata are kept."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
import trimesh
from trimesh.visual.material import PBRMaterial

import mr360uw as uw
from mr360uw.base.color import decode, encode
from mr360uw.scene.model import Scene, scene_from_dict
from mr360uw.video import open_video, read_picture
from mr360uw.video.clip import EncodeSettings
from mr360uw.video.opening import transcode
from tests.video.clips import write_clip
from tests.video.tolerances import VIDEO_CODE_LIGHT, VIDEO_LOSSY_MEAN

_PQ, _HLG, _BT2020 = 16, 18, 9
_DISPLAY = "G(13250,34500)B(7500,3000)R(34000,16000)WP(15635,16450)L(10000000,50)"
_GRADED = f"log-level=none:master-display={_DISPLAY}:max-cll=1000,400"


def hdr_clip(path: Path, curve: int = _PQ, frames: int = 3) -> Path:
    return write_clip(
        path, frames, codec="libx265", pixel_format="yuv420p10le", tags=(1, _BT2020, _BT2020, curve),
        options={"x265-params": _GRADED},
    )  # fmt: skip


def tags_of(path: Path) -> tuple[int, ...]:
    with av.open(str(path)) as container:
        context = container.streams.video[0].codec_context
        return tuple(int(n) for n in (context.colorspace, context.color_primaries, context.color_trc))


@pytest.mark.parametrize(("curve", "name"), [(_PQ, "pq"), (_HLG, "hlg")])
def test_the_tagged_curve_is_followed(tmp_path: Path, curve: int, name: str) -> None:
    plate = hdr_clip(tmp_path / "plate.mp4", curve)
    with open_video(plate) as video:
        assert (video.spec.transfer, video.spec.gamut, video.spec.bits) == (name, "bt2020", 10)
        assert video.hdr is not None
        display, content = video.hdr
        assert content == (1000, 400)
        assert display is not None
        assert display[4] == pytest.approx((0.005, 1000.0))
        assert display[0] == pytest.approx((0.68, 0.32))
    with open_video(plate, "srgb", primaries="bt709") as video:
        assert (video.spec.transfer, video.spec.gamut) == ("srgb", "bt709")


@pytest.mark.parametrize("codec", ["h264", "h265", "av1"])
def test_tags_and_metadata_are_kept(tmp_path: Path, codec: str) -> None:
    plate, copy = hdr_clip(tmp_path / "plate.mp4"), tmp_path / "copy.mp4"
    transcode(plate, copy, EncodeSettings(codec=codec))  # type: ignore[arg-type]
    assert tags_of(copy) == (_BT2020, _BT2020, _PQ)
    with open_video(plate) as one, open_video(copy) as other:
        assert other.hdr is not None
        assert one.hdr is not None
        display, content = other.hdr
        assert content == one.hdr[1]
        assert display is not None
        assert display[4] == pytest.approx((0.005, 1000.0), rel=2e-3)
        # SVT-AV1 rounds to parts of a power of 2
        assert display[3] == pytest.approx((0.3127, 0.3290), abs=1e-4)


def lamp_scene(folder: Path, plate: Path) -> Scene:
    """A lamp at ten times white in the middle of a plate."""
    lamp = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
    lamp.visual = trimesh.visual.TextureVisuals(
        material=PBRMaterial(emissiveFactor=[1.0, 1.0, 1.0], baseColorFactor=[0.0, 0.0, 0.0, 1.0])
    )
    lamp.export(folder / "lamp.glb")
    return scene_from_dict(
        {
            "plate": {"path": str(plate)},
            "camera": {"depth_m": 3.0},
            "light": {"sun": "none"},
            "output": {"codec": "h265", "quality": 4},
            "object": [{"mesh": "lamp.glb", "position_m": [0.0, 0.0, -1.5], "exposure": np.log2(10.0)}],
        },
        folder,
    )


def test_an_object_above_white_goes_into_a_pq_clip(tmp_path: Path) -> None:
    """PQ has codes for its light, where an sRGB plate would end at white."""
    plate, made = hdr_clip(tmp_path / "plate.mp4"), tmp_path / "made.mp4"
    uw.composite_video(lamp_scene(tmp_path, plate), made, frames=(0, 1))
    assert tags_of(made) == (_BT2020, _BT2020, _PQ)
    with open_video(made) as video:
        picture = next(iter(video.frames(0, 1))).image_linear
    seen = picture[28:36, 60:68].mean()
    assert 5.0 < seen < 10.5  # water takes a part of it
    assert float(encode(np.array(seen), "srgb")) > 1.0
    away = picture[:, :20]
    with open_video(plate) as video:
        np.testing.assert_allclose(
            away.mean(), next(iter(video.frames(0, 1))).image_linear[:, :20].mean(), rtol=VIDEO_LOSSY_MEAN
        )


def test_exr_of_an_ordinary_clip_keeps_light_above_white(tmp_path: Path) -> None:
    """Where objects are: what the codes of the plate could not hold is in the file, and nothing else differs."""
    plate = write_clip(tmp_path / "plate.mp4", 1)
    scene = lamp_scene(tmp_path, plate)
    for name in ("made.exr", "made.png"):
        uw.composite_video(scene, tmp_path / name, frames=(0, 1))
    light, codes = read_picture(tmp_path / "made.exr"), decode(read_picture(tmp_path / "made.png") / 255.0, "srgb")
    assert light[28:36, 60:68].mean() > 5.0
    bright = np.any(light > 1.0, axis=-1)
    np.testing.assert_allclose(np.maximum(light[~bright], 0.0), codes[~bright], atol=VIDEO_CODE_LIGHT)
    with open_video(plate) as video:
        own = next(iter(video.frames(0, 1))).image_linear
    np.testing.assert_allclose(light[:, :20], own[:, :20], rtol=2e-3, atol=1e-4)  # EXR in half precision
