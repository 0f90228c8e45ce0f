# SPDX-License-Identifier: Apache-2.0
"""Files for YouTube and Quest as these places recommend them, and encoders of graphics cards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import pytest

from mr360uw.base.color import ColorSpec
from mr360uw.errors import ParameterError, VideoError
from mr360uw.video import encoder, open_video, transcode
from mr360uw.video.clip import CODECS, HARDWARE, Clip, EncodeSettings
from mr360uw.video.encoder import delivery_of
from tests.video.boxes import children
from tests.video.clips import write_clip

_IDR = {"h264": {5}, "hevc": {19, 20}}
"""Kinds of NAL units of pictures that nothing before is needed for (H.264 table 7-1, H.265 table 7-1)."""


def first_slice(packet: bytes, codec: str) -> int:
    """Return the kind of the first slice in a packet of units with lengths of four bytes."""
    at = 0
    while at < len(packet):
        kind = packet[at + 4] & 31 if codec == "h264" else packet[at + 4] >> 1 & 63
        if kind in (range(1, 6) if codec == "h264" else range(32)):
            return kind
        at += 4 + int.from_bytes(packet[at : at + 4], "big")
    raise AssertionError("no slice")


@pytest.mark.parametrize(
    ("target", "source", "codec", "pixel_format", "profile"),
    [
        ("youtube-360", "yuv420p", "h264", "yuv420p", "High"),
        ("youtube-360", "yuv422p10le", "h264", "yuv420p", "High"),
        ("quest", "yuv420p", "hevc", "yuv420p", "Main"),
        ("quest", "yuv420p10le", "hevc", "yuv420p10le", "Main 10"),
    ],
)
def test_files_are_as_recommended(
    tmp_path: Path, target: Any, source: str, codec: str, pixel_format: str, profile: str
) -> None:
    plate = write_clip(tmp_path / "in.mp4", 40, pixel_format=source, codec="libx264", audio_s=1.6)
    made = tmp_path / "out.mp4"
    transcode(plate, made, EncodeSettings(target=target))
    with av.open(str(made)) as container:
        stream = container.streams.video[0]
        context = stream.codec_context
        assert (context.name, context.pix_fmt, context.profile) == (codec, pixel_format, profile)
        assert context.codec_tag == ("avc1" if codec == "h264" else "hvc1")
        assert container.streams.audio[0].codec_context.name == "aac"
        packets = [p for p in container.demux(stream) if p.pts is not None]
    keys = [p for p in packets if p.is_keyframe]
    step = Fraction(25, 2)
    assert [round(float(p.pts * p.time_base * 25)) for p in keys] == [0, *(round(step) * k for k in (1, 2, 3))]
    assert {first_slice(bytes(p), codec) for p in keys} <= _IDR[codec], "closed groups"
    data = made.read_bytes()
    kinds = [kind for kind, _, _ in children(data, 0, len(data))]
    assert kinds.index(b"moov") < kinds.index(b"mdat")
    with open_video(made) as video:
        assert video.spherical is not None


@pytest.mark.parametrize(
    ("size", "rate", "transfer", "wanted"),
    [
        ((3840, 2160), 30, "srgb", 45.0), ((3840, 2160), 60, "srgb", 68.0), ((7680, 4320), 24, "srgb", 160.0),
        ((1920, 1080), 50, "srgb", 12.0), ((1280, 720), 25, "srgb", 5.0), ((3840, 2160), 30, "pq", 56.0),
        ((2560, 1440), 60, "hlg", 30.0), ((5760, 2880), 30, "srgb", pytest.approx(84.85, abs=0.01)),
        ((640, 360), 30, "srgb", pytest.approx(2.239, abs=0.001)),
        ((15360, 8640), 30, "srgb", pytest.approx(569, abs=1)),
    ],
)  # fmt: skip
def test_bit_rates_are_those_of_the_table(size: tuple[int, int], rate: int, transfer: Any, wanted: Any) -> None:
    """At its sizes the table's; between and beyond, powers of the number of pixels, worked out by hand."""
    like = Clip(
        path=Path(), width=size[0], height=size[1], frame_rate=Fraction(rate), time_base=Fraction(1, rate),
        spec=ColorSpec(transfer=transfer, bits=10),
    )  # fmt: skip
    found = delivery_of(EncodeSettings(target="youtube-360"), like)
    assert found is not None
    codec, _, options = found
    assert int(options["b"]) / 1e6 == wanted
    assert codec == ("h264" if transfer == "srgb" else "h265")
    assert delivery_of(EncodeSettings(), replace(like)) is None


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"target": "youtube-360", "codec": "av1"}, "target - decides codec"),
        ({"target": "quest", "pixel_format": "yuv444p"}, "decides pixel_format"),
        ({"target": "quest", "quality": 20, "codec": "h265"}, "decides codec and quality"),
        ({"encoder": "hevc_nvenc", "preset": "slow"}, "preset - is of software encoders"),
        ({"encoder": "hevc_nvenc", "codec": "av1"}, "makes h265, not av1"),
        ({"encoder": "h264_qsv", "quality": "lossless"}, "lossless is not available with h264_qsv"),
        ({"encoder": "h264_voodoo"}, "encoder"),
    ],
)
def test_choices_that_contradict_each_other(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        EncodeSettings(**values)


def test_targets_take_their_kind_of_file_and_encoder(tmp_path: Path) -> None:
    plate = write_clip(tmp_path / "in.mp4", 2)
    with pytest.raises(VideoError, match=r'out\.mkv - output\.target = "quest" is an mp4 \(got \.mkv\) - name it'):
        transcode(plate, tmp_path / "out.mkv", EncodeSettings(target="quest"))
    with pytest.raises(VideoError, match=r"takes h265 for this plate \(got h264_nvenc\) - take one of hevc_nvenc"):
        transcode(plate, tmp_path / "out.mp4", EncodeSettings(target="quest", encoder="h264_nvenc"))
    assert [p.name for p in tmp_path.iterdir()] == ["in.mp4"]


def test_check_names_the_codec_of_a_target(tmp_path: Path, run: Callable[..., Any]) -> None:
    write_clip(tmp_path / "plate.mp4", 2)
    (tmp_path / "scene.toml").write_text('plate = "plate.mp4"\n[output]\ntarget = "quest"\n', "utf-8")
    code, said, _ = run("check", tmp_path / "scene.toml", "--backend", "reference")
    assert (code, said.splitlines()[-1]) == (0, "output    .mp4 can hold h265 and the plate's sound; or pictures")


def test_a_card_s_encoder_is_tried_first(
    tmp_path: Path, run: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_clip(tmp_path / "plate.mp4", 2)
    (tmp_path / "scene.toml").write_text('plate = "plate.mp4"\n[output]\nencoder = "hevc_nvenc"\n', "utf-8")
    monkeypatch.setattr(encoder, "refusal", lambda name: f"no card for {name}")
    code, _, errors = run("composite", tmp_path / "scene.toml", tmp_path / "out.mp4")
    assert code == 2
    assert errors.count("output.encoder - hevc_nvenc does not open on this machine (got: no card for hevc_nvenc)") == 1
    assert 'set output.encoder = "software" and output.codec = "h265", which is libx265' in errors
    assert not (tmp_path / "out.mp4").exists()


def test_auto_takes_a_card_that_encodes_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(encoder, "refusal", lambda name: "" if name in ("h264_qsv", "hevc_qsv") else "no such card")
    with open_video(write_clip(tmp_path / "in.mp4", 2)) as plate:
        for codec, name in (("h264", "h264_qsv"), ("h265", "hevc_qsv")):
            settings = EncodeSettings(codec=codec, encoder="auto")
            chosen, said = encoder.chosen_encoder(settings, plate, tmp_path / "out.mp4")
            assert (chosen.encoder, chosen.encoder_name) == (name, name)
            assert said == f'output.encoder = "auto" took {name}: the file differs from those of machines without it'
        chosen, _ = encoder.chosen_encoder(EncodeSettings(target="quest", encoder="auto"), plate, tmp_path / "out.mp4")
        assert chosen.encoder == "hevc_qsv"
        wide = EncodeSettings(encoder="auto", pixel_format="yuv410p")
        chosen, said = encoder.chosen_encoder(wide, plate, tmp_path / "out.mp4")
        assert chosen.encoder == "software"
        assert "h264_qsv: it does not take yuv410p" in said
        named = EncodeSettings(encoder="h264_nvenc")
        assert encoder.chosen_encoder(named, plate, tmp_path / "out.mp4") == (named, "")


@pytest.mark.parametrize("codec", ["h265", "ffv1"])
def test_auto_without_a_card_is_software_and_the_report_says_so(
    tmp_path: Path, run: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, codec: str
) -> None:
    write_clip(tmp_path / "plate.mp4", 2)
    (tmp_path / "scene.toml").write_text(
        f'plate = "plate.mp4"\n[output]\nencoder = "auto"\ncodec = "{codec}"\n', "utf-8"
    )
    monkeypatch.setattr(encoder, "refusal", lambda _: "no card")
    out = tmp_path / "out.mkv"
    code, said, _ = run("composite", tmp_path / "scene.toml", out, "--backend", "reference")
    assert code == 0
    why = " (hevc_nvenc, hevc_qsv, hevc_amf, hevc_vaapi, hevc_videotoolbox: no card)" if codec == "h265" else ""
    assert f'note: output.encoder = "auto" took {CODECS[codec].software}: no card encodes {codec} here{why}\n' in said
    assert transcode(tmp_path / "plate.mp4", tmp_path / "same.mkv", EncodeSettings(codec=codec, encoder="auto")) == 2


def test_encoders_are_tried_by_a_picture() -> None:
    assert encoder.refusal("libx264") == ""
    assert encoder.refusal("libnothing") == "this FFmpeg does not have it"
    assert set(encoder.opening_encoders()) <= set(HARDWARE)
    assert EncodeSettings(encoder="av1_nvenc", quality=30).encoder_options()["cq"] == "30"
