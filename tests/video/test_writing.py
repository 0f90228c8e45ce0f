# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
import queue
import subprocess
import sys
import textwrap
import threading
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from mr360uw.base.color import encode
from mr360uw.errors import OutputExistsError, ParameterError, VideoError
from mr360uw.types import Layer, Tile
from mr360uw.video import EncodeSettings, create_video, open_video, read_picture, read_spherical, transcode
from tests.video.boxes import mark_v1
from tests.video.clips import decoded, packets, write_clip, write_trimmed_clip
from tests.video.tolerances import (
    VIDEO_CODE_LIGHT,
    VIDEO_DITHER_MEAN,
    VIDEO_LOSSY_MEAN,
    VIDEO_MEMORY_GROWTH,
    VIDEO_PICTURE_CODES,
)

LOSSLESS = EncodeSettings(quality="lossless", preset="ultrafast")


def assert_same_pictures(first: Path, second: Path) -> None:
    ours, theirs = decoded(first), decoded(second)
    assert [pts for pts, _ in ours] == [pts for pts, _ in theirs]
    for (_, a), (_, b) in zip(ours, theirs, strict=True):
        for plane, other in zip(a, b, strict=True):
            np.testing.assert_array_equal(plane, other)


# --- what goes through unchanged ---


@pytest.mark.parametrize(
    ("pixel_format", "codec", "tags"),
    [
        ("yuv420p", "h264", (1, 1, 1, 1)),
        ("yuvj420p", "h264", (2, 1, 1, 1)),
        ("yuv420p10le", "h265", (1, 9, 9, 14)),
        ("yuv422p10le", "h264", (1, 6, 6, 6)),
    ],
)
def test_a_lossless_copy_has_the_same_codes_times_and_tags(tmp_path, pixel_format, codec, tags) -> None:
    source = write_clip(tmp_path / "in.mp4", pixel_format=pixel_format, tags=tags, time_base=Fraction(1, 12800),
                        pts=[7000 + 512 * k for k in range(12)])  # fmt: skip
    target = tmp_path / "out.mp4"
    assert transcode(source, target, EncodeSettings(codec=codec, quality="lossless", preset="ultrafast")) == 12
    assert_same_pictures(source, target)
    with open_video(source) as a, open_video(target) as b:
        assert (a.tags, a.spec, a.pixel_format, a.time_base) == (b.tags, b.spec, b.pixel_format, b.time_base)
        assert [f.duration for f in b.frames()] == [512] * 12
    assert list(tmp_path.glob("*.part")) == []


def test_full_range_camera_footage_stays_full_range(tmp_path) -> None:
    source = write_clip(
        tmp_path / "in.mp4", 8, pixel_format="yuvj420p", tags=(2, 1, 1, 1), size=(192, 108),
        time_base=Fraction(1, 30000), pts=[990 + 1001 * k for k in range(8)], rate=Fraction(30000, 1001),
        camera_data=[bytes(16)],
    )  # fmt: skip
    target = tmp_path / "out.mp4"
    transcode(source, target, LOSSLESS, stop=4, equirectangular=False)
    for (pts, planes), (expected_pts, expected) in zip(decoded(target), decoded(source)[:4], strict=True):
        assert pts == expected_pts
        np.testing.assert_array_equal(planes[0], expected[0])
    with open_video(target, equirectangular=False) as video:
        assert video.spec.full_range


def test_variable_frame_rate_is_kept(tmp_path) -> None:
    pts = [5000, 5003, 5004, 5100, 5101, 5250, 5251, 5252, 5300, 5400]
    source = write_clip(tmp_path / "vfr.mp4", 10, pts=pts, time_base=Fraction(1, 1000), audio_s=6.0)
    transcode(source, tmp_path / "out.mp4", EncodeSettings(preset="medium"))  # with B-frames
    assert [p for p, _ in decoded(tmp_path / "out.mp4")] == pts


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv"])
def test_sound_is_copied_bit_by_bit(tmp_path, suffix) -> None:
    source = write_clip(tmp_path / "in.mp4", 25, audio_s=1.0)
    target = tmp_path / f"out{suffix}"
    transcode(source, target)
    ours, theirs = packets(target, "audio"), packets(source, "audio")
    assert [data for _, _, data in ours] == [data for _, _, data in theirs]
    if suffix != ".mkv":  # Matroska counts milliseconds
        assert [(p, d) for p, d, _ in ours] == [(p, d) for p, d, _ in theirs]


def test_camera_sound_with_an_edit_list(tmp_path) -> None:
    source, _ = write_trimmed_clip(tmp_path / "in.mp4")
    target = tmp_path / "out.mp4"
    transcode(source, target, EncodeSettings(preset="ultrafast"))
    assert [data for _, _, data in packets(target, "audio")] == [data for _, _, data in packets(source, "audio")]
    assert [p for p, _ in decoded(target)] == [p for p, _ in decoded(source)]


def test_a_part_begins_where_the_clip_began(tmp_path) -> None:
    source = write_clip(tmp_path / "in.mp4", 50, audio_s=2.0, time_base=Fraction(1, 12800),
                        pts=[512 * k for k in range(50)])  # fmt: skip
    target = tmp_path / "out.mp4"
    transcode(source, target, LOSSLESS, start=25, stop=40)
    ours, theirs = decoded(target), decoded(source)[25:40]
    assert [pts for pts, _ in ours] == [pts - 25 * 512 for pts, _ in theirs]
    np.testing.assert_array_equal(ours[0][1][0], theirs[0][1][0])
    kept = packets(target, "audio")
    expected = [(p, data) for p, _, data in packets(source, "audio") if 48000 <= p < 48000 * 40 // 25]
    assert [(p + 48000, data) for p, _, data in kept] == expected
    with open_video(source) as video, create_video(tmp_path / "segment.mp4", video, LOSSLESS, rebase=False) as out:
        for frame in video.frames(25, 40):
            out.write(frame)
    assert [pts for pts, _ in decoded(tmp_path / "segment.mp4")] == [pts for pts, _ in theirs]


def test_the_encoder_chooses_its_own_picture_types(tmp_path) -> None:
    """A plate of keyframes only must not force keyframes upon the output."""
    source = write_clip(tmp_path / "in.mp4", 20, options={"g": "1"})
    transcode(source, tmp_path / "out.mp4")
    with av.open(str(tmp_path / "out.mp4")) as container:
        assert sum(frame.key_frame for frame in container.decode(video=0)) == 1


@pytest.mark.parametrize("codec", ["h264", "h265", "av1"])
@pytest.mark.parametrize("frames", [1, 2, 3])
def test_very_short_clips(tmp_path, codec, frames) -> None:
    transcode(write_clip(tmp_path / "in.mp4"), tmp_path / "out.mp4", EncodeSettings(codec=codec), stop=frames)
    assert [pts for pts, _ in decoded(tmp_path / "out.mp4")] == [pts for pts, _ in decoded(tmp_path / "in.mp4")][
        :frames
    ]


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="threads have no policy here")
def test_an_encoder_does_not_outrank_what_feeds_it(tmp_path) -> None:
    """SVT-AV1 sets itself and its caller to real-time priority where it may: as root."""
    transcode(write_clip(tmp_path / "in.mp4"), tmp_path / "out.mp4", EncodeSettings(codec="av1"), stop=3)
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_hevc_is_tagged_for_every_player(tmp_path) -> None:
    source = write_clip(tmp_path / "in.mp4", 3)
    transcode(source, tmp_path / "out.mp4", EncodeSettings(codec="h265", preset="ultrafast"))
    with av.open(str(tmp_path / "out.mp4")) as container:
        assert container.streams.video[0].codec_context.codec_tag == "hvc1"


@pytest.mark.parametrize(
    ("codec", "suffix", "pixel_format"),
    [("av1", ".mp4", "yuv420p"), ("av1", ".webm", "yuv420p10le"), ("ffv1", ".mkv", "yuv420p"),
     ("ffv1", ".mkv", "yuv420p10le"), ("prores", ".mov", "yuv422p10le"), ("h265", ".mov", "yuv420p10le")],
)  # fmt: skip
def test_every_codec(tmp_path, codec, suffix, pixel_format) -> None:
    source = write_clip(tmp_path / "in.mkv", 3, pixel_format=pixel_format.replace("422p10le", "420p"))
    transcode(source, tmp_path / f"out{suffix}", EncodeSettings(codec=codec, preset="ultrafast"))
    with open_video(tmp_path / f"out{suffix}") as video:
        assert (video.pixel_format, video.frame_count) == (pixel_format, 3)
        ours = next(video.frames()).image_linear
    with open_video(source) as video:
        np.testing.assert_allclose(
            ours.mean((0, 1)), next(video.frames()).image_linear.mean((0, 1)), rtol=VIDEO_LOSSY_MEAN
        )
    if codec == "ffv1":
        np.testing.assert_array_equal(decoded(tmp_path / f"out{suffix}")[2][1][0], decoded(source)[2][1][0])


@pytest.mark.parametrize(("codec", "suffix"), [("av1", ".mp4"), ("h265", ".mp4"), ("ffv1", ".mkv"), ("prores", ".mov")])
def test_every_codec_keeps_full_range(tmp_path, codec, suffix) -> None:
    source = write_clip(tmp_path / "in.mp4", 2, pixel_format="yuvj420p", tags=(2, 1, 1, 1))
    transcode(source, tmp_path / f"out{suffix}", EncodeSettings(codec=codec, preset="ultrafast"))
    with open_video(source) as plate, open_video(tmp_path / f"out{suffix}") as video:
        expected = next(plate.frames()).image_linear.mean((0, 1))
        np.testing.assert_allclose(next(video.frames()).image_linear.mean((0, 1)), expected, rtol=VIDEO_LOSSY_MEAN)


def test_upside_down_footage_comes_out_upright(tmp_path) -> None:
    source = write_clip(tmp_path / "in.mp4", 2, rotation=180)
    transcode(source, tmp_path / "out.mp4", LOSSLESS)
    np.testing.assert_array_equal(decoded(tmp_path / "out.mp4")[1][1][0], decoded(source)[1][1][0][::-1, ::-1])
    with av.open(str(tmp_path / "out.mp4")) as container:
        assert next(container.decode(video=0)).rotation == 0


def test_one_eye_is_written_as_mono(tmp_path) -> None:
    source = mark_v1(write_clip(tmp_path / "in.mp4", 3, size=(128, 128)), "top-bottom")
    target = tmp_path / "out.mp4"
    with open_video(source, eye="right") as video, create_video(target, video, LOSSLESS) as out:
        for frame in video.frames(0, 2):
            out.write(frame)
    np.testing.assert_array_equal(decoded(target)[1][1][0], decoded(source)[1][1][0][64:])
    metadata = read_spherical(target)
    assert metadata is not None
    assert metadata.stereo == "mono"


# --- frames with something laid over ---


def tile(column: int, row: int, height: int, width: int, radiance: float) -> Tile:
    full = np.ones((height, width, 3), np.float32)
    return Tile(column, row, full * radiance, np.ones((height, width)), np.ones((height, width)), full, 0 * full)


def test_a_composite_arrives_in_the_file(tmp_path) -> None:
    source = write_clip(tmp_path / "in.mp4", 4, pixel_format="yuv420p10le")
    target = tmp_path / "out.mp4"
    layer = Layer(64, 128, (tile(20, 10, 20, 30, 0.25),))
    with open_video(source) as video, create_video(target, video, LOSSLESS) as out:
        for frame in video.frames():
            out.write(frame.over(layer))
    with open_video(target) as video, open_video(source) as plate:
        for new, old in zip(video.frames(), plate.frames(), strict=True):
            np.testing.assert_allclose(new.image_linear[14:26, 24:46].mean(), 0.25, rtol=VIDEO_DITHER_MEAN)
            outside = np.ones((64, 128), bool)
            outside[10:30, 20:50] = False
            np.testing.assert_array_equal(new.yuv.y[outside], old.yuv.y[outside])


def test_a_layer_without_tiles_costs_nothing(tmp_path) -> None:
    with open_video(write_clip(tmp_path / "in.mp4", 1)) as video:
        frame = next(video.frames())
        assert frame.over(Layer(64, 128, ())) is frame
        with pytest.raises(VideoError, match="layer"):
            frame.over(Layer(32, 64, (tile(0, 0, 2, 2, 0.1),)))
        for column, row in ((-2, 0), (120, 0), (0, 60)):
            with pytest.raises(VideoError, match="out of the frame"):
                frame.over(Layer(64, 128, (tile(column, row, 10, 10, 0.1),)))


# --- pictures ---


def write_png(path: Path, dtype=np.uint8) -> np.ndarray:
    codes = np.random.default_rng(3).integers(0, np.iinfo(dtype).max, (16, 32, 3), dtype, endpoint=True)
    codes[:] = cv2.GaussianBlur(codes, (0, 0), 4)
    cv2.imwrite(str(path), codes[..., ::-1])
    return codes


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_still_over_which_something_is_laid(tmp_path, dtype) -> None:
    codes = write_png(tmp_path / "in.png", dtype)
    with open_video(tmp_path / "in.png") as video, create_video(tmp_path / "out.png", video) as out:
        out.write(next(video.frames()).over(Layer(16, 32, (tile(4, 5, 6, 7, 0.3),))))
        with pytest.raises(VideoError, match="cannot hold several frames"):
            out.write(next(video.frames()))
    result = cv2.imread(str(tmp_path / "out.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    inside = np.zeros((16, 32), bool)
    inside[5:11, 4:11] = True
    np.testing.assert_array_equal(result[~inside], codes[~inside])
    with open_video(tmp_path / "out.png") as video:
        np.testing.assert_allclose(next(video.frames()).image_linear[inside].mean(0), 0.3, rtol=VIDEO_DITHER_MEAN)


def test_a_still_becomes_a_clip(tmp_path) -> None:
    write_png(tmp_path / "in.png")
    settings = EncodeSettings(quality="lossless", pixel_format="yuv444p")
    with (
        open_video(tmp_path / "in.png", frame_rate=24) as video,
        create_video(tmp_path / "out.mp4", video, settings) as out,
    ):
        for frame in video.frames(0, 5):
            out.write(frame)
    with open_video(tmp_path / "out.mp4") as clip:
        assert (clip.frame_count, clip.frame_rate, clip.tags.colorspace) == (5, 24, 1)
        times = [frame.time_s for frame in clip.frames()]
        assert times == pytest.approx([k / 24 for k in range(5)])
        linear = next(clip.frames()).image_linear
    with open_video(tmp_path / "in.png") as video:
        difference = encode(linear, "srgb") - encode(next(video.frames()).image_linear, "srgb")
    assert np.abs(difference).max() * 255 < VIDEO_PICTURE_CODES


@pytest.mark.parametrize("suffix", ["png", "exr", "jpg", "tif", "hdr"])
def test_a_clip_becomes_pictures(tmp_path, suffix) -> None:
    source = write_clip(tmp_path / "in.mp4", 4, pixel_format="yuv420p10le")
    with open_video(source) as video:
        with create_video(tmp_path / f"out_%03d.{suffix}", video) as out:
            for frame in video.frames(1, 3):
                out.write(frame)
        names = sorted(p.name for p in tmp_path.glob("out*"))
        assert names == [f"out_001.{suffix}", f"out_002.{suffix}"]
        expected = next(video.frames(1)).image_linear
        with open_video(tmp_path / f"out_%03d.{suffix}") as again:
            ours = next(again.frames()).image_linear
        expected = np.clip(expected, 0, 1 if suffix in ("png", "jpg", "tif") else None)
        np.testing.assert_allclose(expected.mean((0, 1)), ours.mean((0, 1)), rtol=VIDEO_LOSSY_MEAN)
        with pytest.raises(OutputExistsError, match="out_001"):
            create_video(tmp_path / f"out_%03d.{suffix}", video)


def test_exr_pictures_of_floats_keep_every_bit(tmp_path, rng) -> None:
    from mr360uw.video import write_exr

    light = (10.0 ** rng.uniform(-6, 5, (8, 16, 3))).astype(np.float32)
    write_exr(tmp_path / "in.exr", light)
    with open_video(tmp_path / "in.exr") as video, create_video(tmp_path / "out.exr", video) as out:
        out.write(next(video.frames()).over(Layer(8, 16, (tile(1, 1, 2, 2, 40.0),))))
    result = read_picture(tmp_path / "out.exr")
    assert result[1, 1, 0] == 40.0
    untouched = np.ones((8, 16), bool)
    untouched[1:3, 1:3] = False
    np.testing.assert_array_equal(result[untouched], light[untouched])


def test_a_new_video_without_a_plate(tmp_path) -> None:
    ramp = np.linspace(0, 1, 128)[None, :, None] * np.ones((64, 1, 3))
    sound = write_clip(tmp_path / "sound.mp4", 25, audio_s=1.0)
    with create_video(tmp_path / "new.mp4", None, LOSSLESS, width=128, height=64, frame_rate=25, sound=sound) as out:
        for k in range(25):
            out.write_image(ramp * (k + 1) / 25)
    with open_video(tmp_path / "new.mp4") as video:
        assert (video.frame_count, video.frame_rate, video.sound is None) == (25, 25, False)
        assert video.spherical is not None
        np.testing.assert_allclose(next(video.frames(24)).image_linear, ramp, atol=VIDEO_CODE_LIGHT)
    assert packets(tmp_path / "new.mp4", "audio") == packets(sound, "audio")
    with pytest.raises(VideoError, match="2:1"):
        create_video(tmp_path / "flat.mp4", width=160, height=90)


def test_pictures_are_marked_as_panoramas(tmp_path) -> None:
    write_png(tmp_path / "in.png")
    with open_video(tmp_path / "in.png") as video:
        frame = next(video.frames())
        for suffix in ("jpg", "png"):
            with create_video(tmp_path / f"out.{suffix}", video) as out:
                out.write(frame)
            data = (tmp_path / f"out.{suffix}").read_bytes()
            assert b'GPano:ProjectionType="equirectangular"' in data
            assert b'GPano:FullPanoWidthPixels="32"' in data
            assert cv2.imread(str(tmp_path / f"out.{suffix}")).shape == (16, 32, 3)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "out.png"))[..., ::-1], frame.rgb)


def test_matroska_is_marked_by_a_tag(tmp_path) -> None:
    transcode(write_clip(tmp_path / "in.mp4", 2), tmp_path / "out.mkv")
    with open_video(tmp_path / "out.mkv") as video:
        assert video.spherical is not None
        assert (video.spherical.source, video.spherical.projection) == ("V1", "equirectangular")


def test_one_thread_reads_and_another_writes(tmp_path) -> None:
    source = write_clip(tmp_path / "in.mp4", 40)
    waiting: queue.Queue = queue.Queue(4)
    with open_video(source) as video:

        def read() -> None:
            for frame in video.frames():
                waiting.put(frame)
            waiting.put(None)

        thread = threading.Thread(target=read)
        thread.start()
        with create_video(tmp_path / "out.mp4", video, LOSSLESS) as out:
            for frame in iter(waiting.get, None):
                out.write(frame)
        thread.join()
    assert_same_pictures(source, tmp_path / "out.mp4")


# --- what goes wrong ---


def test_nothing_is_overwritten_unless_asked(tmp_path) -> None:
    source = write_clip(tmp_path / "in.mp4", 2)
    target = tmp_path / "out.mp4"
    target.write_bytes(b"precious")
    with pytest.raises(OutputExistsError, match="already there"):
        transcode(source, target)
    assert target.read_bytes() == b"precious"
    with pytest.raises(VideoError, match="which this run reads"):
        transcode(source, source, overwrite=True)
    transcode(source, target, overwrite=True)
    assert len(decoded(target)) == 2


def test_bad_targets(tmp_path, monkeypatch) -> None:
    (tmp_path / "folder.mp4").mkdir()
    with open_video(write_clip(tmp_path / "in.mp4", 2)) as video:
        for name, message in (
            ("missing/out.mp4", "output folder is missing"),
            ("folder.mp4", "is a folder"),
            ("out.xyz", "not known .got .xyz"),
            ("out", "not known"),
        ):
            with pytest.raises(VideoError, match=message):
                create_video(tmp_path / name, video)
        with pytest.raises(VideoError, match="cannot hold prores"):
            create_video(tmp_path / "out.mp4", video, EncodeSettings(codec="prores"))
        with pytest.raises(VideoError, match="no frame was written"), create_video(tmp_path / "none.mp4", video):
            pass
        monkeypatch.setattr("os.access", lambda *_: False)  # the tests may run as root, who may write anywhere
        with pytest.raises(VideoError, match="may not be written to"):
            create_video(tmp_path / "out.mp4", video)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["folder.mp4", "in.mp4"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_an_interrupted_output_leaves_nothing(tmp_path, error) -> None:
    source = write_clip(tmp_path / "in.mp4", 8, audio_s=0.3)
    (tmp_path / "old.mp4").write_bytes(b"old")
    for name in ("new.mp4", "old.mp4"):
        video = open_video(source)
        with pytest.raises(error), create_video(tmp_path / name, video, overwrite=True) as out:
            for frame in video.frames():
                out.write(frame)
                if frame.index == 5:
                    raise error
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in.mp4", "old.mp4"]
    assert (tmp_path / "old.mp4").read_bytes() == b"old"


def test_frames_of_another_size_or_after_the_end(tmp_path) -> None:
    with open_video(write_clip(tmp_path / "in.mp4", 2)) as video:
        small = open_video(write_clip(tmp_path / "small.mp4", 1, size=(64, 32)))
        with pytest.raises(VideoError, match="another size"), create_video(tmp_path / "out.mp4", video) as out:
            out.write(next(small.frames()))
        with create_video(tmp_path / "out.mp4", video) as out:
            out.write(next(video.frames()))
        with pytest.raises(VideoError, match="already complete"):
            out.write(next(video.frames()))


def run(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    root = Path(__file__).resolve().parents[2]
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)],
        capture_output=True, text=True, cwd=root, check=False,
    )  # fmt: skip


def test_a_full_disk_is_said_and_leaves_nothing(tmp_path) -> None:
    """A limit on the size of a file makes writing fail in the middle, as a full disk does."""
    source = write_clip(tmp_path / "in.mp4", 40, size=(512, 256), options={"qp": "0", "preset": "ultrafast"})
    done = run(
        """
        import resource, sys
        from mr360uw.errors import VideoError
        from mr360uw.video import EncodeSettings, transcode
        resource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000))
        try:
            transcode(sys.argv[1], sys.argv[2], EncodeSettings(quality="lossless", preset="ultrafast"))
        except VideoError as error:
            sys.exit(str(error))
        """,
        source,
        tmp_path / "out.mp4",
    )
    assert done.returncode == 1, done.stderr
    assert "File too large" in done.stderr
    assert "check the space left" in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["in.mp4"]


def test_memory_does_not_grow_with_the_clip(tmp_path) -> None:
    peaks = []
    for frames in (60, 600):
        source = write_clip(tmp_path / f"in{frames}.mp4", frames, audio_s=frames / 25, options={"preset": "ultrafast"})
        done = run(
            """
            import resource, sys
            from pathlib import Path
            from mr360uw.video import EncodeSettings, transcode
            transcode(sys.argv[1], sys.argv[2], EncodeSettings(preset="ultrafast"))
            status = Path("/proc/self/status")  # ru_maxrss counts what the parent held before this began
            lines = status.read_text().splitlines() if status.exists() else []
            peak = next((line.split()[1] for line in lines if line.startswith("VmHWM")), None)
            print(peak or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
            """,
            source,
            tmp_path / f"out{frames}.mp4",
        )
        assert done.returncode == 0, done.stderr
        peaks.append(int(done.stdout))
    assert peaks[1] / peaks[0] - 1 < VIDEO_MEMORY_GROWTH


def test_nothing_keeps_a_frame_that_was_written(tmp_path) -> None:
    """Not even itself: frames of a large clip would fill the memory until Python next looks for such rings."""
    source = write_clip(tmp_path / "in.mp4", 2)
    with open_video(source) as video, create_video(tmp_path / "out.mp4", video, LOSSLESS) as out:
        for frame in video.frames():
            before = sys.getrefcount(frame.native)
            out.write(frame)
            after = sys.getrefcount(frame.native)
            assert after == before


def test_settings_refuse_nonsense() -> None:
    for wrong in ({"codec": "h266"}, {"quality": 99}, {"codec": "av1", "quality": "lossless"}, {"speed": 3}):
        with pytest.raises(ParameterError):
            EncodeSettings(**wrong)
