# SPDX-License-Identifier: Apache-2.0
"""What files say beside their pictures, in and out: tags, spherical metadata, codec, shape of pixels, tracks."""

from __future__ import annotations

import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from mr360uw.errors import VideoError
from mr360uw.ibl.tilt import level_matrix
from mr360uw.render.surroundings import CameraPath, pose_notes
from mr360uw.scene.model import scene_from_dict
from mr360uw.video import create_video, open_video, read_spherical, transcode
from mr360uw.video.clip import EncodeSettings
from tests.video.boxes import box, changed, children, full_box, mark_v1, mark_v2
from tests.video.clips import fill, moving_planes, write_clip

_ENTRY = [b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"avc1"]
_POSE_DEG = (0.0, 15.0, 10.0)


def mark_posed(path: Path, *, stereo: int = 0, half: bool = False) -> Path:
    """Add V2 boxes with a pose, or those of VR180: the half of the sphere in front, an eye each."""
    quarter = round(0.25 * 2**32)
    pose = full_box(b"prhd", struct.pack(">3i", *(0, 0, 0) if half else (round(65536 * a) for a in _POSE_DEG)))
    bounds = full_box(b"equi", struct.pack(">4I", *(0, 0, quarter, quarter) if half else (0, 0, 0, 0)))
    marks = full_box(b"st3d", bytes([stereo])) + box(
        b"sv3d", full_box(b"svhd", b"another tool\0"), box(b"proj", pose, bounds)
    )
    path.write_bytes(changed(path.read_bytes(), _ENTRY, lambda content: content + marks))
    return path


def quicktime_keys(words: dict[str, str]) -> bytes:
    """Return the 'meta' box of QuickTime's keys, as phones and cameras write it into the movie."""
    names = b"".join(box(b"mdta", name.encode()) for name in words)
    values = b"".join(
        box(struct.pack(">I", number), box(b"data", struct.pack(">II", 1, 0), text.encode()))
        for number, text in enumerate(words.values(), 1)
    )
    handler = full_box(b"hdlr", bytes(4), b"mdta", bytes(13))
    return box(b"meta", handler, full_box(b"keys", struct.pack(">I", len(words)), names), box(b"ilst", values))


def with_tags(path: Path, *boxes: bytes) -> Path:
    """Put boxes at the end of the movie's index, which lies behind the media."""
    data = path.read_bytes()
    _, start, end = next(one for one in children(data, 0, len(data)) if one[0] == b"moov")
    path.write_bytes(data[:start] + box(b"moov", data[start + 8 : end], *boxes) + data[end:])
    return path


def told(path: Path) -> dict[str, Any]:
    """Return what FFmpeg reads of a file: words without those of its format, codec, pixels, tracks."""
    own = {"major_brand", "minor_version", "compatible_brands", "encoder"}
    with av.open(str(path)) as container:
        video = container.streams.video[0]
        aspect = video.sample_aspect_ratio
        return {
            "words": {name.lower(): text for name, text in container.metadata.items() if name.lower() not in own},
            "codec": video.codec_context.name,
            "format": video.codec_context.pix_fmt,
            "aspect": None if aspect is None else Fraction(aspect.numerator, aspect.denominator),
            "language": video.metadata.get("language"),
            "tracks": [(s.type, s.metadata.get("language"), int(s.disposition) & 1) for s in container.streams],
        }


_CAMERA = {
    "com.apple.quicktime.make": "Insta360",
    "com.apple.quicktime.model": "X4",
    "com.apple.quicktime.creationdate": "2024-05-01T12:00:00+0200",
    "com.apple.quicktime.location.ISO6709": "+20.5000-087.2000/",
}
_OLD_TAGS = b"".join(
    box(name, struct.pack(">HH", len(text), 0), text)
    for name, text in ((b"\xa9mak", b"GoPro"), (b"\xa9mod", b"MAX"), (b"\xa9xyz", b"+20.5000-087.2000/"))
)


@pytest.mark.parametrize("suffix", [".mp4", ".mov"])
def test_tags_of_cameras_are_kept_byte_for_byte(tmp_path: Path, suffix: str) -> None:
    """Keys of QuickTime, tags of the older kind, and boxes that FFmpeg has no name for, as GoPro's."""
    source, target = write_clip(tmp_path / f"in{suffix}", 3), tmp_path / f"out{suffix}"
    own = box(b"FIRM", b"H19.03.02.02.00")
    with_tags(source, quicktime_keys(_CAMERA), box(b"udta", _OLD_TAGS, own))
    transcode(source, target)
    assert told(target) == told(source)
    assert _CAMERA.items() <= dict(av.open(str(target)).metadata).items()
    assert told(target)["words"]["make"] == "GoPro"
    for one in (quicktime_keys(_CAMERA), _OLD_TAGS, own):
        assert target.read_bytes().count(one) == 1


def test_words_go_from_kind_to_kind(tmp_path: Path) -> None:
    """Of Matroska they become QuickTime's keys, and back; the time of the recording is one and the same."""
    words = {"title": "Dive 7", "MAKE": "Insta360", "COM.APPLE.QUICKTIME.CREATIONDATE": "2024-05-01T12:00:00+0200"}
    source = tmp_path / "in.mkv"
    with av.open(str(source), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 128, 64, "yuv420p"
        stream.metadata.update({"language": "eng", "timecode": "01:00:00:00"})
        container.metadata.update(words | {"creation_time": "2024-05-01T10:00:00Z"})
        native = av.VideoFrame(128, 64, "yuv420p")
        fill(native, moving_planes(0))
        native.pts, native.time_base = 0, Fraction(1, 25)
        container.mux([*stream.encode(native), *stream.encode(None)])
    for before, after in (("in.mkv", "out.mp4"), ("out.mp4", "again.mkv"), ("in.mkv", "same.mkv")):
        transcode(tmp_path / before, tmp_path / after)
        found = told(tmp_path / after)
        assert {name.lower(): text for name, text in words.items()}.items() <= found["words"].items()
        assert found["words"]["creation_time"].startswith("2024-05-01T10:00:00")
        assert found["language"] == "eng"
        assert found["tracks"][0] == ("video", "eng", 1)
        with av.open(str(tmp_path / after)) as container:
            tags = {name.lower(): text for name, text in container.streams.video[0].metadata.items()}
        assert tags["timecode"] == "01:00:00:00"


@pytest.mark.parametrize("mark", ["V1", "V2", "posed"])
def test_spherical_metadata_come_back_field_by_field(tmp_path: Path, mark: str) -> None:
    """V1's first view is no pose, and V2's pose no first view."""
    source, target = write_clip(tmp_path / "in.mp4", 2), tmp_path / "out.mp4"
    if mark == "V1":
        mark_v1(source, first_view=(90, -20))
    else:
        mark_v2(source) if mark == "V2" else mark_posed(source)
    transcode(source, target)
    before, after = read_spherical(source), read_spherical(target)
    assert before is not None
    assert after is not None
    for name in ("projection", "stereo", "pose_deg", "view_deg", "bounds"):
        assert getattr(after, name) == getattr(before, name)
    assert after.pose_deg == (_POSE_DEG if mark == "posed" else (0.0, 0.0, 0.0))
    assert after.view_deg == ((90.0, -20.0, 0.0) if mark == "V1" else (0.0, 0.0, 0.0))
    assert (b"InitialView" in target.read_bytes()) == (mark == "V1")


def test_a_pose_is_the_level_of_the_camera(tmp_path: Path, run: Callable[..., Any]) -> None:
    """Pitch lifts the centre, roll turns clockwise, as V2 says; what the scene says goes first."""
    path = mark_posed(write_clip(tmp_path / "dive.mp4", 2))
    scene = scene_from_dict({"plate": str(path), "water": {"type": "none"}}, tmp_path)
    _, rotation = CameraPath.of(scene).at(0.0)
    np.testing.assert_allclose(rotation, level_matrix(np.radians(10.0), np.radians(15.0)), atol=1e-6)
    assert rotation[1, 0] < 0.0 < rotation[1, 1]  # the picture's right lies low
    assert (rotation @ [0.0, 0.0, -1.0])[1] > 0.2  # and its centre is above the horizon
    (note,) = pose_notes(scene)
    assert "pitch 15 and roll 10" in note
    for camera, says in (
        ({"pitch_deg": 0.0}, "camera.pitch_deg says how the camera is held"),
        ({"pitch_deg": 15.0, "roll_deg": 10.0}, None),
    ):
        own = scene_from_dict({"plate": str(path), "water": {"type": "none"}, "camera": camera}, tmp_path)
        assert [says in line for line in pose_notes(own) if says] == [True] * bool(says)
    flat = scene_from_dict({"plate": str(path), "water": {"type": "none"}, "camera": {"pitch_deg": 0.0}}, tmp_path)
    assert CameraPath.of(flat).tilt is None
    (tmp_path / "scene.toml").write_text('plate = "dive.mp4"\n[water]\ntype = "none"\n', "utf-8")
    _, out, _ = run("check", tmp_path / "scene.toml", tmp_path / "out.mp4")
    assert out.count("states a pose of pitch 15 and roll 10 degrees: the camera is held so") == 1
    _, out, _ = run("check", tmp_path / "scene.toml", tmp_path / "out.mkv")
    assert "its pose is not kept" in out


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_the_shape_of_pixels_is_kept(tmp_path: Path, suffix: str) -> None:
    source, target = tmp_path / f"in{suffix}", tmp_path / f"out{suffix}"
    with av.open(str(source), "w") as container:
        stream = container.add_stream("libx264", rate=25)
        stream.width, stream.height, stream.pix_fmt = 128, 64, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(4, 3)
        native = av.VideoFrame(128, 64, "yuv420p")
        fill(native, moving_planes(0))
        native.pts, native.time_base = 0, Fraction(1, 25)
        container.mux([*stream.encode(native), *stream.encode(None)])
    transcode(source, target)
    assert told(target)["aspect"] == told(source)["aspect"] == Fraction(4, 3)


@pytest.mark.parametrize(
    ("codec", "pixel_format", "settings", "made", "says"),
    [
        ("libx264", "yuv420p", {}, "h264", ""),
        ("libx265", "yuv420p10le", {}, "hevc", "h265 is taken"),
        ("libx264", "yuv422p10le", {}, "hevc", "h265 is taken"),
        ("libx265", "yuv420p10le", {"codec": "h264"}, "h264", "do not decode"),
        ("libx265", "yuv420p10le", {"codec": "h265"}, "hevc", ""),
        ("libx265", "yuv420p10le", {"pixel_format": "yuv420p"}, "h264", ""),
    ],
)
def test_more_than_eight_bits_are_written_as_players_decode_them(
    tmp_path: Path, codec: str, pixel_format: str, settings: dict[str, Any], made: str, says: str
) -> None:
    source = write_clip(tmp_path / "in.mp4", 4, codec=codec, pixel_format=pixel_format)
    with open_video(source) as video, create_video(tmp_path / "out.mp4", video, EncodeSettings(**settings)) as out:
        for frame in video.frames():
            out.write(frame)
    found = told(tmp_path / "out.mp4")
    assert (found["codec"], found["format"]) == (made, settings.get("pixel_format", pixel_format))
    assert [says in note for note in out.notes if "output.codec" in note] == [True] * bool(says)


def test_the_half_of_the_sphere_is_refused_with_the_way_to_a_plate(tmp_path: Path) -> None:
    """VR180 as cameras tag it: bounds of a quarter at the left and the right, an eye each."""
    path = mark_posed(write_clip(tmp_path / "in.mp4", 2), stereo=2, half=True)
    with pytest.raises(
        VideoError, match=r"is VR180 by its tags, an eye each.*crop=iw/2:ih:0:0,pad=2\*iw:ih:iw/2:0 in_360.mp4"
    ):
        open_video(path, eye="left")


def many_tracks(path: Path, *, second_is_default: bool) -> Path:
    """Two tracks of pictures (frames 0 and 50), and Spanish subtitles."""
    (path.parent / "words.srt").write_text("1\n00:00:00,000 --> 00:00:00,040\nhola\n\n", "utf-8")
    with av.open(str(path.parent / "words.srt")) as words, av.open(str(path), "w") as container:
        streams = [container.add_stream("libx264", rate=25, options={"qp": "0"}) for _ in range(2)]
        for number, stream in enumerate(streams):
            stream.width, stream.height, stream.pix_fmt = 128, 64, "yuv420p"
            stream.metadata["title"] = ("wide", "near")[number]
            stream.disposition = av.stream.Disposition(int(number == second_is_default))
        text = container.add_stream_from_template(words.streams[0])
        text.metadata["language"] = "spa"
        for number, stream in enumerate(streams):
            native = av.VideoFrame(128, 64, "yuv420p")
            fill(native, moving_planes(50 * number))
            native.pts, native.time_base = 0, Fraction(1, 25)
            container.mux([*stream.encode(native), *stream.encode(None)])
        for packet in words.demux():
            if packet.dts is not None:
                packet.stream = text
                container.mux(packet)
    return path


@pytest.mark.parametrize("second_is_default", [False, True])
def test_the_default_track_is_worked_on_and_lost_ones_are_named(tmp_path: Path, *, second_is_default: bool) -> None:
    source = many_tracks(tmp_path / "in.mkv", second_is_default=second_is_default)
    with open_video(source) as video:
        first = next(iter(video.frames()))
        assert first.yuv is not None
        np.testing.assert_array_equal(first.yuv.y, moving_planes(50 * second_is_default)[0])
        lost = {}
        for suffix in (".mkv", ".mp4"):
            with create_video(tmp_path / f"out{suffix}", video) as out:
                out.write(first)
            lost[suffix] = [note for note in out.notes if "not copied" in note]
    other = f"video track {int(not second_is_default)} ({'wide' if second_is_default else 'near'}) is not copied"
    assert [other in note for note in lost[".mkv"]] == [True]
    assert [part in note for part, note in zip((other, "subtitle track 2 (spa)"), lost[".mp4"], strict=True)] == [
        True
    ] * 2
    assert [track[:2] for track in told(tmp_path / "out.mkv")["tracks"]][1:] == [("subtitle", "spa")]
