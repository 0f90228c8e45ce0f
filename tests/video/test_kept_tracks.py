# SPDX-License-Identifier: Apache-2.0
"""Outputs keep what a camera's file holds besides pictures and sound: data, time code, chapters, spatial audio."""

from __future__ import annotations

import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import pytest

from mr360uw.video import create_video, open_video, transcode
from mr360uw.video.clip import EncodeSettings
from mr360uw.video.demux import open_local, open_packets
from mr360uw.video.other_tracks import later_timecode
from tests.video.boxes import box, changed
from tests.video.clips import packets, write_clip

_PAYLOADS = [b"DEVC" + bytes([n]) * 12 for n in range(2)]
# version 0, periphonic, order 1, ACN, SN3D, four channels in their order (Spatial Audio RFC)
_SA3D = box(b"SA3D", struct.pack(">BBIBBI4I", 0, 0, 1, 0, 0, 4, 0, 1, 2, 3))


def camera_clip(folder: Path) -> Path:
    """Two seconds with sound, GPMF, the time code 01:00:59:20 and two chapters; written by FFmpeg alone."""
    plain, path = write_clip(folder / "plain.mp4", 50, audio_s=2.0, camera_data=_PAYLOADS), folder / "camera.mp4"
    with av.open(str(plain)) as source, av.open(str(path), "w") as target:
        made = {s.index: target.add_stream_from_template(s) for s in source.streams}
        made[0].metadata["timecode"] = "01:00:59:20"
        base = Fraction(1, 1000)
        target.set_chapters([
            {"id": 1, "start": 0, "end": 1200, "time_base": base, "metadata": {"title": "reef"}},
            {"id": 2, "start": 1200, "end": 2000, "time_base": base, "metadata": {"title": "wreck"}},
        ])  # fmt: skip
        for packet in source.demux():
            if packet.dts is not None:
                packet.stream = made[packet.stream_index]
                target.mux(packet)
    return path


def data_packets(path: Path) -> list[tuple[float, bytes]]:
    with av.open(str(path)) as container:
        streams = [
            s for s in container.streams if s.type == "data" and s.metadata.get("handler_name") != "SubtitleHandler"
        ]
        found = [p for s in streams if "timecode" not in s.metadata for p in container.demux(s) if p.dts is not None]
        return [(float(p.pts * p.time_base), bytes(p)) for p in found]


def told(path: Path) -> tuple[str, list[tuple[float, float, str]]]:
    """Return time code and chapters as FFmpeg reads them."""
    with av.open(str(path)) as container:
        chapters = [
            (float(c["start"] * c["time_base"]), float(c["end"] * c["time_base"]), c["metadata"]["title"])
            for c in container.chapters()
        ]
        return container.streams.video[0].metadata.get("timecode", ""), chapters


@pytest.mark.parametrize("suffix", [".mp4", ".mov"])
def test_data_time_code_and_chapters_are_kept(tmp_path: Path, suffix: str) -> None:
    source, target = camera_clip(tmp_path), tmp_path / f"out{suffix}"
    transcode(source, target)
    assert data_packets(target) == [(0.0, _PAYLOADS[0]), (1.0, _PAYLOADS[1])]
    assert told(target) == told(source) == ("01:00:59:20", [(0.0, 1.2, "reef"), (1.2, 2.0, "wreck")])
    assert b"gpmd" in target.read_bytes()
    with open_video(source) as video, create_video(tmp_path / f"b{suffix}", video) as out:
        assert out.notes == ()
        out.write(next(iter(video.frames())))


def test_sound_and_data_are_opened_without_a_picture(tmp_path: Path) -> None:
    """No picture is decoded, so that the format of its pixels is not known; all packets are those of the file."""
    path = camera_clip(tmp_path)
    with open_local(path) as whole, open_packets(path) as opened:
        assert (whole.streams.video[0].pix_fmt, opened.streams.video[0].pix_fmt) == ("yuv420p", None)
        assert [(s.type, s.time_base) for s in opened.streams] == [(s.type, s.time_base) for s in whole.streams]
        sounds = [container.streams.audio[0].codec_context for container in (whole, opened)]
        assert sounds[0].layout.name == sounds[1].layout.name
        assert sounds[0].profile == sounds[1].profile == "LC"
        assert [(p.dts, p.size) for p in opened.demux()] == [(p.dts, p.size) for p in whole.demux()]


def test_a_part_takes_its_own(tmp_path: Path) -> None:
    """From frame 20 on, at 25 a second: data that begin within, chapters cut, time code moved over the minute."""
    source, target = camera_clip(tmp_path), tmp_path / "out.mp4"
    transcode(source, target, start=20, stop=45)
    assert data_packets(target) == [(pytest.approx(0.2), _PAYLOADS[1])]
    assert told(target) == ("01:01:00:15", [(0.0, pytest.approx(0.4), "reef"), (pytest.approx(0.4), 1.0, "wreck")])


def test_matroska_keeps_the_chapters_and_says_what_it_does_not(tmp_path: Path) -> None:
    source, target = camera_clip(tmp_path), tmp_path / "out.mkv"
    transcode(source, target)
    assert told(target)[1] == [(0.0, 1.2, "reef"), (1.2, 2.0, "wreck")]
    with open_video(source) as video, create_video(tmp_path / "b.mkv", video) as out:
        assert sum("data track 2 (GoPro MET) is not copied" in note for note in out.notes) == 1
        out.write(next(iter(video.frames())))
    transcode(source, tmp_path / "without.mp4", EncodeSettings(data=False))
    assert data_packets(tmp_path / "without.mp4") == []
    assert told(tmp_path / "without.mp4") == ("", [])


@pytest.mark.parametrize(
    ("first", "frame", "rate", "later"),
    [
        ("00:00:59;29", 1, Fraction(30000, 1001), "00:01:00;02"),
        ("00:09:59;29", 1, Fraction(30000, 1001), "00:10:00;00"),
        ("00:00:00;00", 17982 * 6, Fraction(30000, 1001), "01:00:00;00"),
        ("00:00:59;59", 1, Fraction(60000, 1001), "00:01:00;04"),
        ("23:59:59:23", 1, Fraction(24), "00:00:00:00"),
    ],
)
def test_time_codes_count_on(first: str, frame: int, rate: Fraction, later: str) -> None:
    """The examples of SMPTE ST 12-1: numbers are left out of each minute but the tenth."""
    assert later_timecode(first, frame, rate) == later


def mark_spatial(path: Path) -> None:
    """Append SA3D to the audio track's sample entry; the index lies behind the media, so nothing else moves."""
    trail: list[Any] = [b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"mp4a"]
    path.write_bytes(changed(path.read_bytes(), trail, lambda body: body + _SA3D, track=b"soun"))


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv"])
def test_the_mark_of_spatial_audio_is_kept(tmp_path: Path, suffix: str) -> None:
    source, target = write_clip(tmp_path / "in.mp4", 10, audio_s=0.4), tmp_path / f"out{suffix}"
    mark_spatial(source)
    with open_video(source) as video, create_video(target, video) as out:
        for frame in video.frames():
            out.write(frame)
    data = target.read_bytes()
    assert data.count(_SA3D) == (suffix != ".mkv")
    assert any("SA3D" in note for note in out.notes) == (suffix == ".mkv")
    assert [p[2] for p in packets(target, "audio")] == [p[2] for p in packets(source, "audio")]


def test_check_says_what_the_output_lacks(tmp_path: Path, run: Callable[..., Any]) -> None:
    camera_clip(tmp_path)
    (tmp_path / "scene.toml").write_text('plate = "camera.mp4"\n', "utf-8")
    for name, said in (("out.mp4", False), ("out.mkv", True)):
        code, out, _ = run("check", tmp_path / "scene.toml", tmp_path / name)
        assert (code, "data track 2 (GoPro MET) is not copied" in out) == (0, said)


def test_words_in_another_encoding_are_copied_byte_for_byte(tmp_path: Path) -> None:
    """As tools write them that know no UTF-8: "Café Riff" in Latin-1."""
    plain, path, copy = write_clip(tmp_path / "plain.mp4", 3), tmp_path / "named.mp4", tmp_path / "copy.mp4"
    with av.open(str(plain)) as source, av.open(str(path), "w") as target:
        made = target.add_stream_from_template(source.streams.video[0])
        target.metadata["title"] = "Caf_ Riff"
        for packet in source.demux(source.streams.video[0]):
            if packet.dts is not None:
                packet.stream = made
                target.mux(packet)
    path.write_bytes(path.read_bytes().replace(b"Caf_ Riff", b"Caf\xe9 Riff"))
    with open_video(path) as video:
        assert video.words["title"].encode(errors="surrogateescape") == b"Caf\xe9 Riff"
    transcode(path, copy)
    assert b"Caf\xe9 Riff" in copy.read_bytes()
