# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import struct
from functools import partial

import av
import numpy as np
import pytest

from mr360uw.errors import VideoError
from mr360uw.video import SphericalMetadata, open_video, read_spherical, transcode, write_spherical
from mr360uw.video.spherical import Box, edit_moov, from_side_data, parse_boxes, read_moov, sample_entries, video_track
from tests import tolerances as tol
from tests.video.boxes import mark_v1, mark_v2
from tests.video.clips import decoded, packets, write_clip

MARKS = {"V1": mark_v1, "V2": mark_v2, "V2, FFmpeg's order": partial(mark_v2, layout="ffmpeg")}
TOP_BOTTOM = {"V1": "top-bottom", "V2": 1, "V2, FFmpeg's order": 1}


def ffmpeg_says(path):
    """What FFmpeg reads, an independent reader of both versions."""
    with av.open(str(path)) as container:
        return from_side_data(next(container.decode(video=0)).side_data)


@pytest.mark.parametrize("stereo", ["mono", "top-bottom"])
@pytest.mark.parametrize("layout", MARKS)
def test_marks_of_other_tools_are_read(tmp_path, layout, stereo) -> None:
    path = write_clip(tmp_path / "in.mp4", 2, size=(128, 64 if stereo == "mono" else 128))
    MARKS[layout](path, *([] if stereo == "mono" else [TOP_BOTTOM[layout]]))
    metadata = read_spherical(path)
    assert metadata is not None
    assert (metadata.projection, metadata.stereo, metadata.source) == ("equirectangular", stereo, layout[:2])
    assert (metadata.bounds, metadata.pose_deg, metadata.problems) == ((0, 0, 0, 0), (0, 0, 0), ())
    theirs = ffmpeg_says(path)
    assert (theirs.projection, theirs.stereo, theirs.pose_deg) == ("equirectangular", stereo, metadata.pose_deg)


def test_matroska_and_unmarked_files(tmp_path) -> None:
    path = write_clip(tmp_path / "in.mp4", 12)
    with open_video(path) as video:
        assert video.spherical is None
    mark_v2(path)
    with av.open(str(path)) as source, av.open(str(tmp_path / "in.mkv"), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(source.streams.video[0]):
            if packet.dts is not None:
                packet.stream = stream
                target.mux(packet)
    with open_video(tmp_path / "in.mkv") as video:
        assert video.spherical == SphericalMetadata(source="side data")


@pytest.mark.parametrize("suffix", [".mp4", ".mov"])
@pytest.mark.parametrize("codec", ["libx264", "libx265"])
@pytest.mark.parametrize("movflags", ["", "faststart"])
@pytest.mark.parametrize("front", [False, True])
def test_marking_changes_no_packet(tmp_path, suffix, codec, movflags, front) -> None:
    """The media data move, and every chunk offset with them."""
    options = {"movflags": movflags} if movflags else {}
    path = write_clip(tmp_path / f"in{suffix}", 25, codec=codec, audio_s=1.0, container_options=options)
    before = [packets(path, "video"), packets(path, "audio")]
    for _ in range(2):  # the second time replaces
        write_spherical(path, SphericalMetadata(), front)
        assert [packets(path, "video"), packets(path, "audio")] == before
    assert len(decoded(path)) == 25
    metadata = read_spherical(path)
    assert (metadata.source, metadata.problems, metadata.stereo) == ("V1+V2", (), "mono")
    assert ffmpeg_says(path).projection == "equirectangular"
    track = video_track(read_moov(path))
    assert [box.kind for box in track.children].count(b"uuid") == 1
    kinds = [box.kind for box in sample_entries(track)[0].children]
    assert (kinds.count(b"st3d"), kinds.count(b"sv3d")) == (1, 1)
    data = path.read_bytes()
    assert (data.index(b"moov") < data.index(b"mdat")) == (front or bool(movflags))


def test_pose_and_both_versions_agree_with_ffmpeg(tmp_path) -> None:
    path = write_clip(tmp_path / "in.mp4", 2)
    write_spherical(path, SphericalMetadata(pose_deg=(30.0, 10.0, -5.0)))
    assert read_spherical(path).pose_deg == (30.0, 10.0, -5.0)
    assert ffmpeg_says(path).pose_deg == (30.0, 10.0, -5.0)
    for kind in (b"uuid", b"sv3d"):  # each version alone
        alone = tmp_path / f"{kind.decode()}.mp4"
        alone.write_bytes(path.read_bytes())
        edit_moov(alone, lambda moov, kind=kind: drop(moov, kind))
        assert ffmpeg_says(alone).projection == "equirectangular"


def drop(moov: Box, kind: bytes) -> None:
    track = video_track(moov)
    for box in (track, *sample_entries(track)):
        box.children = [child for child in box.children if child.kind != kind]


def test_contradictions_are_told_and_v2_wins(tmp_path) -> None:
    path = write_clip(tmp_path / "in.mp4", 2)
    write_spherical(path, SphericalMetadata())
    data = path.read_bytes()
    at = data.index(b"st3d")
    path.write_bytes(data[: at + 8] + b"\x01" + data[at + 9 :])
    metadata = read_spherical(path)
    assert metadata.stereo == "top-bottom"
    assert metadata.problems == ("V1 says stereo mono, V2 says top-bottom; V2 is taken",)


def test_projections_that_are_no_full_sphere_are_refused(tmp_path) -> None:
    path = write_clip(tmp_path / "in.mp4", 2)
    write_spherical(path, SphericalMetadata())
    data = path.read_bytes()
    at = data.index(b"equi") + 8
    path.write_bytes(data[:at] + struct.pack(">I", 1 << 30) + data[at + 4 :])
    assert read_spherical(path).bounds == (0.25, 0.0, 0.0, 0.0)
    with pytest.raises(VideoError, match=r"only part of the sphere"):
        open_video(path)
    path.write_bytes(data.replace(b"equi", b"cbmp"))
    with pytest.raises(VideoError, match=r"projection not supported .got cubemap"):
        open_video(path)


def test_a_cropped_panorama_says_what_lacks_at_each_side(tmp_path) -> None:
    whole = {"FullPanoWidthPixels": 200, "FullPanoHeightPixels": 100}
    part = {"CroppedAreaImageWidthPixels": 100, "CroppedAreaImageHeightPixels": 50}
    place = {"CroppedAreaLeftPixels": 30, "CroppedAreaTopPixels": 20}
    path = mark_v1(write_clip(tmp_path / "in.mp4", 2), **whole, **part, **place)
    np.testing.assert_allclose(read_spherical(path).bounds, (0.2, 0.3, 0.15, 0.35), atol=tol.FLOAT64)


def test_broken_xml_and_entities_are_not_followed(tmp_path) -> None:
    path = write_clip(tmp_path / "in.mp4", 2)
    write_spherical(path, SphericalMetadata())
    data = path.read_bytes()
    for bad in (b"<rdf:Spherica<Video", b"<!DOCTYPE x [<!ENT"):
        broken = tmp_path / "broken.mp4"
        broken.write_bytes(data.replace(b"<rdf:SphericalVideo", bad.ljust(19), 1))
        metadata = read_spherical(broken)
        assert metadata.projection == "equirectangular"
        assert any("V1 holds" in problem for problem in metadata.problems)


@pytest.mark.parametrize("heading", ["nan", "inf", "1e400", "north"])
def test_a_first_view_that_is_no_number_is_left_out(tmp_path, heading) -> None:
    plate = mark_v1(write_clip(tmp_path / "plate.mp4", 2), first_view=(heading, 5))
    transcode(plate, tmp_path / "out.mp4")
    assert read_spherical(tmp_path / "out.mp4").view_deg == (0.0, 5.0, 0.0)


def test_fragmented_files_are_refused(tmp_path) -> None:
    path = write_clip(tmp_path / "in.mp4", 12, container_options={"movflags": "frag_keyframe+empty_moov"})
    before = path.read_bytes()
    with pytest.raises(VideoError, match="fragmented"):
        write_spherical(path, SphericalMetadata())
    assert path.read_bytes() == before
    with open_video(path) as video:
        assert video.frame_count == 12


def test_files_without_boxes_are_refused(tmp_path) -> None:
    path = write_clip(tmp_path / "in.mkv", 2)
    assert read_spherical(path) is None
    with pytest.raises(VideoError, match="not an mp4"):
        write_spherical(path, SphericalMetadata())


def test_64_bit_and_open_ended_box_sizes(tmp_path) -> None:
    """A media box whose size is told by a 64-bit field, or that reaches to the end of the file."""
    whole = write_clip(tmp_path / "in.mp4", 12, container_options={"movflags": "faststart"})
    expected = packets(whole, "video")
    data = whole.read_bytes()
    at = data.index(b"mdat") - 4
    size = struct.unpack(">I", data[at : at + 4])[0]
    assert at + size == len(data)
    open_ended = tmp_path / "open.mp4"
    open_ended.write_bytes(data[:at] + bytes(4) + data[at + 4 :])
    large = tmp_path / "large.mp4"
    large.write_bytes(data[: at - 8] + struct.pack(">I4sQ", 1, b"mdat", size + 8) + data[at + 8 :])
    assert data[at - 4 : at] == b"free"
    for path in (open_ended, large):
        assert packets(path, "video") == expected
        write_spherical(path, SphericalMetadata())
        assert packets(path, "video") == expected
        assert ffmpeg_says(path).projection == "equirectangular"


def test_offsets_that_outgrow_32_bits_get_a_wider_table() -> None:
    from mr360uw.video.spherical import _with_offsets

    offsets = np.array([100, (1 << 32) - 10], np.int64)
    table = Box(b"stco", struct.pack(">II", 0, 2) + offsets.astype(">u4").tobytes())
    tree = Box(b"moov", children=[Box(b"trak", children=[table])])
    assert _with_offsets(tree, lambda o: o + 100, wide=False) is None
    wide = _with_offsets(tree, lambda o: o + 100, wide=True)
    table = wide.find(b"trak").children[0]
    assert table.kind == b"co64"
    np.testing.assert_array_equal(np.frombuffer(table.payload[8:], ">u8"), offsets + 100)


def test_the_box_tree_gives_back_the_bytes(tmp_path) -> None:
    path = mark_v2(write_clip(tmp_path / "in.mp4", 2, audio_s=0.2), 0)
    moov, data = read_moov(path), path.read_bytes()
    raw = moov.serialised()
    assert raw in data
    sample_entries(video_track(moov))
    assert moov.serialised() == raw
    assert parse_boxes(raw)[0].serialised() == raw
    with pytest.raises(ValueError, match="boxes"):
        parse_boxes(raw[:-3])


def test_outputs_are_marked(tmp_path) -> None:
    for source in (mark_v1(write_clip(tmp_path / "marked.mp4", 4)), write_clip(tmp_path / "bare.mp4", 4)):
        target = tmp_path / f"out_{source.name}"
        transcode(source, target, stop=3)
        metadata = read_spherical(target)
        assert (metadata.source, metadata.problems) == ("V1+V2", ())
        assert ffmpeg_says(target).stereo == "mono"
