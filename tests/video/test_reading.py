# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from fractions import Fraction

import cv2
import numpy as np
import pytest

from mr360uw.base.color import ColorSpec
from mr360uw.errors import VideoError
from mr360uw.video import open_video, write_exr
from mr360uw.video.reader import DecodedOnce, scaled
from tests.video.boxes import mark_v2
from tests.video.clips import decoded, moving_planes, write_clip, write_trimmed_clip
from tests.video.tolerances import VIDEO_SHARED_EXPONENT

OPEN_GROUPS = {"x264-params": "keyint=5:min-keyint=5:open-gop=1:bframes=3:b-adapt=0:scenecut=0"}


def signatures(video, start=0, stop=None):
    return {f.index: (f.pts, f.yuv.y[::7, ::5].tobytes(), f.yuv.u[::3].tobytes()) for f in video.frames(start, stop)}


@pytest.mark.parametrize(
    ("name", "codec", "options"),
    [
        ("open.mp4", "libx264", OPEN_GROUPS),
        ("open.mkv", "libx264", OPEN_GROUPS),
        ("closed.mov", "libx264", {"g": "6", "bf": "2"}),
        ("hevc.mp4", "libx265", {"x265-params": "log-level=none:keyint=7:min-keyint=7:open-gop=1"}),
        ("intra.mkv", "ffv1", {}),
        ("vp9.webm", "libvpx-vp9", {"deadline": "realtime", "cpu-used": "8", "g": "9"}),
    ],
)
def test_a_frame_is_the_same_however_it_is_reached(tmp_path, name, codec, options) -> None:
    path = write_clip(tmp_path / name, 24, codec=codec, options=options)
    with open_video(path) as video:
        assert video.frame_count == 24
        straight = signatures(video)
        assert list(straight) == list(range(24))
        for start in range(1, 24, 2):
            assert signatures(video, start, min(start + 3, 24)) == {
                k: straight[k] for k in range(start, min(start + 3, 24))
            }


@pytest.mark.parametrize("start", [0, 8])
@pytest.mark.parametrize(("suffix", "options"), [(".mp4", OPEN_GROUPS), (".mp4", {"bf": "3"}), (".mkv", {"bf": "0"})])
def test_a_sampled_pass_has_the_frames_that_are_chosen(tmp_path, suffix, options, start) -> None:
    path = write_clip(tmp_path / f"in{suffix}", 24, options=options)
    with open_video(path) as video:
        every = {frame.index: frame for frame in video.frames()}
        found = list(video.sampled(start, 24, lambda index: index % 5 == 0))
    assert [frame.index for frame in found] == list(range(start, 24))
    assert [frame.index for frame in found if frame.is_read] == [k for k in range(start, 24) if k % 5 == 0]
    for frame in found:
        assert (frame.pts, frame.time_s) == (every[frame.index].pts, every[frame.index].time_s)
        if frame.is_read:
            np.testing.assert_array_equal(frame.yuv.y, every[frame.index].yuv.y)


def test_pictures_that_are_not_chosen_are_not_opened(tmp_path) -> None:
    for k in range(5):
        write_exr(tmp_path / f"plate_{k}.exr", np.full((32, 64, 3), 0.1 * k, np.float32))
    with open_video(tmp_path / "plate_%d.exr") as video:
        (tmp_path / "plate_3.exr").write_bytes(b"damaged")
        half = scaled(DecodedOnce(video, (0, 0)), 0.5)
        found = list(half.sampled(0, 5, lambda index: index % 2 == 0))
    assert [frame.is_read for frame in found] == [True, False, True, False, True]
    assert found[4].shape == (16, 32)


def test_frames_equal_a_plain_decode(tmp_path) -> None:
    path = write_clip(tmp_path / "plain.mp4")
    with open_video(path) as video:
        for frame, (pts, planes) in zip(video.frames(), decoded(path), strict=True):
            assert frame.pts == pts
            for plane, expected in zip((frame.yuv.y, frame.yuv.u, frame.yuv.v), planes, strict=True):
                np.testing.assert_array_equal(plane, expected)


def test_frames_that_an_edit_list_cuts_away_do_not_count(tmp_path) -> None:
    """The clip holds 27 pictures, of which 24 are presented."""
    path, whole = write_trimmed_clip(tmp_path / "cut.mp4")
    with open_video(path) as video:
        assert video.frame_count == 24
        assert video.sound is not None
        assert video.frame_rate == Fraction(30000, 1001)
        straight = [(f.index, f.pts, f.yuv.y.copy()) for f in video.frames()]
        assert [index for index, _, _ in straight] == list(range(24))
        assert [pts for _, pts, _ in straight] == [1001 * k for k in range(24)]
        for (_, _, luma), (_, planes) in zip(straight, whole[3:], strict=True):
            np.testing.assert_array_equal(luma, planes[0])
        for start in (1, 17, 23):
            frame = next(video.frames(start))
            assert (frame.index, frame.pts) == straight[start][:2]
            np.testing.assert_array_equal(frame.yuv.y, straight[start][2])


def test_full_range_camera_footage(tmp_path) -> None:
    pts = [990 + 1001 * k for k in range(40)]
    path = write_clip(
        tmp_path / "camera.mp4", 40, pixel_format="yuvj420p", tags=(2, 1, 1, 1), pts=pts, size=(192, 108),
        time_base=Fraction(1, 30000), rate=Fraction(30000, 1001), camera_data=[bytes(16), bytes(16)],
    )  # fmt: skip
    with open_video(path, equirectangular=False) as video:
        assert video.spec == ColorSpec("bt709", True, "srgb", 8)
        assert (video.frame_count, video.start_pts, video.sound) == (40, 990, None)
        (note,) = video.notes
        assert "camera.mp4 - its data track 1 (GoPro MET) is not copied - write .mp4 or .mov" in note
        frame = next(video.frames(30))
        assert frame.time_s == pytest.approx(30 * 1001 / 30000)
        plain = decoded(path)[30]
        assert plain[0] == frame.pts == pts[30]
        np.testing.assert_array_equal(plain[1][0], frame.yuv.y)


def test_variable_frame_rate_and_late_start(tmp_path) -> None:
    pts = [5000, 5003, 5004, 5100, 5101, 5250, 5251, 5252, 5300, 5400]
    path = write_clip(tmp_path / "vfr.mp4", 10, pts=pts, time_base=Fraction(1, 1000), options={"g": "4"})
    with open_video(path) as video:
        assert video.time_base == Fraction(1, 1000)
        assert [f.pts for f in video.frames()] == pts
        assert [f.time_s for f in video.frames()] == [pytest.approx((p - 5000) / 1000) for p in pts]
        assert [f.pts for f in video.frames(6, 9)] == pts[6:9]


@pytest.mark.parametrize(
    ("codec", "name"), [("libx265", "yuv420p10le"), ("libx264", "yuv422p10le"), ("ffv1", "yuv444p")]
)
def test_depth_and_subsampling(tmp_path, codec, name) -> None:
    path = write_clip(tmp_path / "deep.mkv", 2, codec=codec, pixel_format=name)
    with open_video(path) as video:
        frame = next(video.frames())
    assert video.spec.bits == (10 if "10" in name else 8)
    assert video.pixel_format == name
    assert frame.image_linear.shape == (64, 128, 3)
    assert frame.yuv.y.dtype == (np.uint16 if "10" in name else np.uint8)
    assert np.abs(frame.yuv.y / 2 ** (video.spec.bits - 8) - moving_planes(0)[0]).mean() < video.spec.bits


@pytest.mark.parametrize(
    ("size", "tags", "matrix", "full_range"),
    [
        ((128, 64), (0, 2, 2, 2), "bt601", False),
        ((1440, 720), (0, 2, 2, 2), "bt709", False),
        ((128, 64), (1, 1, 1, 1), "bt709", False),
        ((1440, 720), (1, 6, 6, 6), "bt601", False),
        ((128, 64), (2, 9, 9, 14), "bt2020", True),
    ],
)
def test_colour_tags(tmp_path, size, tags, matrix, full_range) -> None:
    path = write_clip(tmp_path / "tags.mp4", 1, size=size, tags=tags)
    with open_video(path) as video:
        assert (video.spec.matrix, video.spec.full_range, video.spec.transfer) == (matrix, full_range, "srgb")
    with open_video(path, "bt1886") as video:
        assert video.spec.transfer == "bt1886"


def test_planes_are_read_only(tmp_path) -> None:
    """They are the decoder's own pictures, which the next frames refer to."""
    frame = next(open_video(write_clip(tmp_path / "a.mp4")).frames())
    with pytest.raises(ValueError, match="read-only"):
        frame.yuv.y[0, 0] = 1


def test_upside_down_footage_is_turned(tmp_path) -> None:
    straight = next(open_video(write_clip(tmp_path / "a.mp4", 1)).frames())
    turned = next(open_video(write_clip(tmp_path / "b.mp4", 1, rotation=180)).frames())
    np.testing.assert_array_equal(turned.yuv.y, straight.yuv.y[::-1, ::-1])
    assert turned.image_linear.shape == straight.image_linear.shape
    with pytest.raises(VideoError, match="turned by"):
        open_video(write_clip(tmp_path / "c.mp4", 1, rotation=90))


# --- stereo and shape ---


def test_stereo_is_refused_and_one_eye_can_be_taken(tmp_path) -> None:
    path = mark_v2(write_clip(tmp_path / "stereo.mp4", 4, size=(128, 128)), 1)
    with pytest.raises(VideoError, match=r'top-bottom stereo.*plate.eye = "left"'):
        open_video(path)
    whole = decoded(path)[3][1]
    for eye, rows in (("left", slice(0, 64)), ("right", slice(64, 128))):
        with open_video(path, eye=eye) as video:
            assert (video.width, video.height) == (128, 64)
            frame = next(video.frames(3))
        np.testing.assert_array_equal(frame.yuv.y, whole[0][rows])
        np.testing.assert_array_equal(frame.yuv.v, whole[2][rows.start // 2 : rows.stop // 2])


@pytest.mark.parametrize(("size", "layout"), [((64, 64), "top-bottom"), ((256, 64), "left-right")])
def test_stereo_is_told_by_the_shape(tmp_path, size, layout) -> None:
    path = write_clip(tmp_path / "stereo.mp4", 1, size=size)
    with pytest.raises(VideoError, match=layout):
        open_video(path)
    with open_video(path, eye="right") as video:
        assert video.width == 2 * video.height
        np.testing.assert_array_equal(
            next(video.frames()).yuv.y, decoded(path)[0][1][0][-video.height :, -video.width :]
        )


def test_what_is_no_panorama_is_refused(tmp_path) -> None:
    path = write_clip(tmp_path / "flat.mp4", 1, size=(160, 90))
    with pytest.raises(VideoError, match=r"not a 360 degree panorama of 2:1.*160x90"):
        open_video(path)
    with pytest.raises(VideoError, match="not stereo"):
        open_video(write_clip(tmp_path / "mono.mp4", 1), eye="left")
    assert open_video(path, equirectangular=False).width == 160


# --- pictures ---


def picture(value: int, dtype=np.uint8, size=(8, 16)):
    rng = np.random.default_rng(value)
    return rng.integers(0, np.iinfo(dtype).max, (*size, 3), dtype, endpoint=True)


@pytest.mark.parametrize("pattern", ["plate_%04d.png", "plate_####.png", "plate_*.png"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_numbered_pictures(tmp_path, pattern, dtype) -> None:
    for number in range(3):
        cv2.imwrite(str(tmp_path / f"plate_{number + 1001}.png"), picture(number, dtype)[..., ::-1])
    with open_video(tmp_path / pattern, frame_rate=24) as video:
        assert (video.frame_count, video.frame_rate, video.is_still) == (3, 24, False)
        frames = list(video.frames(1))
    assert [(f.index, f.time_s) for f in frames] == [(1, 1 / 24), (2, 2 / 24)]
    np.testing.assert_array_equal(frames[1].rgb, picture(2, dtype))
    assert frames[0].yuv is None


def test_a_still_repeats(tmp_path) -> None:
    cv2.imwrite(str(tmp_path / "still.png"), picture(0)[..., ::-1])
    with open_video(tmp_path / "still.png") as video:
        assert video.is_still
        assert video.frame_count is None
        assert len(list(video.frames())) == 1
        assert [f.index for f in video.frames(5, 9)] == [5, 6, 7, 8]


def test_exr_and_hdr_pictures_are_linear(tmp_path) -> None:
    light = np.random.default_rng(1).uniform(0, 50, (8, 16, 3)).astype(np.float32)
    light[2, 3] = (8000.0, 9000.0, 10000.0)  # a sun
    write_exr(tmp_path / "a.exr", light)
    with open_video(tmp_path / "a.exr") as video:
        np.testing.assert_array_equal(next(video.frames()).image_linear, light)
        assert video.spec.transfer == "linear"
    cv2.imwrite(str(tmp_path / "a.hdr"), light[..., ::-1])
    with open_video(tmp_path / "a.hdr") as video:
        found = next(video.frames()).image_linear
    assert np.all(np.abs(found - light) <= VIDEO_SHARED_EXPONENT * light.max(axis=-1, keepdims=True))


def test_one_eye_of_a_stereo_picture(tmp_path) -> None:
    both = picture(4, size=(32, 32))
    cv2.imwrite(str(tmp_path / "stereo.png"), both[..., ::-1])
    with pytest.raises(VideoError, match="stereo"):
        open_video(tmp_path / "stereo.png")
    for eye, rows in (("left", slice(0, 16)), ("right", slice(16, 32))):
        with open_video(tmp_path / "stereo.png", eye=eye) as video:
            np.testing.assert_array_equal(next(video.frames()).rgb, both[rows])


# --- bad input ---


def test_bad_files(tmp_path) -> None:
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "text.mp4").write_text("this is not a video, whatever its name says\n" * 50)
    whole = write_clip(tmp_path / "whole.mp4", audio_s=0.5)
    (tmp_path / "cut.mp4").write_bytes(whole.read_bytes()[:-2000])
    (tmp_path / "picture.png").write_bytes(b"no picture")
    cases = {
        "missing.mp4": "no such file",
        "empty.mp4": "is empty",
        "text.mp4": "is not a video",
        "cut.mp4": "cut short .*moov",
        "missing.png": "no such file",
        "missing_%04d.png": "no picture has such a name",
        "picture.png": "not a picture",
        ".": "is a folder",
    }
    for name, message in cases.items():
        with pytest.raises(VideoError, match=message) as caught:
            open_video(tmp_path / name)
        assert str(caught.value).count(" - ") >= 2


def test_a_file_without_pictures(tmp_path) -> None:
    import av

    with av.open(str(tmp_path / "sound.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=48000, layout="mono")
        block = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), "fltp", "mono")
        block.sample_rate = 48000
        container.mux(stream.encode(block))
        container.mux(stream.encode(None))
    with pytest.raises(VideoError, match=r"no video stream that can be decoded .got audio"):
        open_video(tmp_path / "sound.mp4")


def test_data_that_end_in_the_middle(tmp_path) -> None:
    """With the index in front, what is there can still be used."""
    whole = write_clip(tmp_path / "whole.mp4", 30, container_options={"movflags": "faststart"}, options={"bf": "0"})
    data = whole.read_bytes()
    (tmp_path / "half.mp4").write_bytes(data[: len(data) * 2 // 3])
    with open_video(tmp_path / "half.mp4") as video:
        with pytest.raises(VideoError, match=r"data end at frame \d+ of 30.*take frames 0:\d+") as caught:
            video.frames()
        usable = int(str(caught.value).rsplit("0:", 1)[1])
        assert 5 < usable < 30
        assert len(list(video.frames(0, usable))) == usable


def test_a_damaged_picture_is_named(tmp_path) -> None:
    path = write_clip(tmp_path / "whole.mov", 20, codec="prores", pixel_format="yuv422p10le")
    with open_video(path) as video:
        ends = video.index.end_byte
    data = bytearray(path.read_bytes())
    data[ends[9] : ends[10]] = bytes(int(ends[10] - ends[9]))
    path.write_bytes(data)
    with open_video(path) as video:
        assert len(list(video.frames(0, 8))) == 8
        with pytest.raises(VideoError, match=r"cannot be decoded after frame \d+"):
            list(video.frames())


def test_ranges_outside_the_clip(tmp_path) -> None:
    with open_video(write_clip(tmp_path / "a.mp4")) as video:
        for start, stop in ((0, 13), (12, None), (5, 5), (-1, 3), (7, 3)):
            with pytest.raises(VideoError, match=r"outside the clip .got .*the clip has 12 frames"):
                video.frames(start, stop)


def test_unsupported_pixel_format(tmp_path) -> None:
    import av

    with av.open(str(tmp_path / "rgb.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.codec_context.width, stream.codec_context.height, stream.codec_context.pix_fmt = 128, 64, "bgra"
        container.mux(stream.encode(av.VideoFrame(128, 64, "bgra")))
        container.mux(stream.encode(None))
    with pytest.raises(VideoError, match=r"pixel format not supported .got bgra"):
        open_video(tmp_path / "rgb.mkv")


def test_sequences_with_a_gap_or_mixed_sizes(tmp_path) -> None:
    for number, size in ((1, (8, 16)), (2, (8, 16)), (4, (8, 16))):
        cv2.imwrite(str(tmp_path / f"gap_{number}.png"), picture(number, size=size))
    with pytest.raises(VideoError, match="picture 3 of the sequence is missing"):
        open_video(tmp_path / "gap_%d.png")
    cv2.imwrite(str(tmp_path / "gap_3.png"), picture(3, size=(16, 32)))
    with open_video(tmp_path / "gap_%d.png") as video, pytest.raises(VideoError, match="differs from the first"):
        list(video.frames())


def test_frames_that_are_kept_are_those_of_the_file_and_are_decoded_once(tmp_path, monkeypatch) -> None:
    with open_video(write_clip(tmp_path / "short.mp4", 12)) as video:
        kept, straight = DecodedOnce(video, (2, 9)), signatures(video)
        assert signatures(kept, 1, 10) == {k: straight[k] for k in range(1, 10)}
        assert kept.are_all
        assert next(kept.frames(2, 3)).image_linear is not next(kept.frames(2, 3)).image_linear
        monkeypatch.setattr(video, "frames", None)
        assert signatures(kept, 2, 9) == {k: straight[k] for k in range(2, 9)}


def test_frames_that_are_too_many_are_not_kept(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("mr360uw.video.reader._MOST_BYTES", 1000)
    with open_video(write_clip(tmp_path / "short.mp4", 12)) as video:
        kept = DecodedOnce(video, (0, 12))
        assert signatures(kept) == signatures(video)
        assert not kept.are_all


def test_smaller_frames_begin_where_the_plate_can_be_decoded(tmp_path) -> None:
    """A draft looks at the frames that a whole composite looks at."""
    clip = write_clip(tmp_path / "clip.mp4", 12, options={"g": "5", "sc_threshold": "0"})
    with open_video(clip) as video:
        assert [video.entry_before(index) for index in (0, 4, 5, 11)] == [0, 0, 5, 10]
        assert [scaled(video, 0.5).entry_before(index) for index in (0, 4, 5, 11)] == [0, 0, 5, 10]
