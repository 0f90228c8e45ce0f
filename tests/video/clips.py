# SPDX-License-Identifier: Apache-2.0
"""Small clips made with FFmpeg alone, so that the tests do not read what the code under test wrote."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np

from mr360uw.base.color import ColorSpec
from mr360uw.types import YuvImage
from tests.video.boxes import shift_edit_list

SIZE = (128, 64)
SPECS = [
    ColorSpec(),
    ColorSpec("bt601", False, "bt709"),
    ColorSpec("bt709", True, "gamma22"),
    ColorSpec("bt709", False, "bt1886", 10),
    ColorSpec("bt2020", False, "srgb", 10),
    ColorSpec("bt2020", False, "hlg", 10),
    ColorSpec("bt2020", False, "pq", 10),
    ColorSpec("bt709", True, "vlog", 10),
]
"""Kinds of plates: matrices, ranges, curves and depths of 8 and 10 bits."""


def moving_planes(index: int, bits: int = 8, subsampling: str = "420", size: tuple[int, int] = SIZE) -> list[Any]:
    """Three planes with a texture that differs from frame to frame."""
    width, height = size
    rng = np.random.default_rng(index)
    scale = 1 << (bits - 8)
    dtype = np.uint8 if bits == 8 else np.uint16
    columns = width // 2 if subsampling != "444" else width
    rows = height // 2 if subsampling == "420" else height
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    luma = 120 + 60 * np.sin(0.1 * (x + 5 * index)) + 20 * np.cos(0.2 * y) + rng.uniform(-3, 3, (height, width))
    chroma = [128 + 40 * np.sin(0.05 * (np.arange(columns) + 3 * index + n)) + np.zeros((rows, 1)) for n in (0, 30)]
    return [np.round(plane * scale).astype(dtype) for plane in (luma, *chroma)]


def yuv_image(index: int = 0, spec: ColorSpec | None = None, subsampling: str = "420") -> YuvImage:
    spec = spec or ColorSpec()
    y, u, v = moving_planes(index, spec.bits, subsampling)
    return YuvImage(y, u, v, spec)


def fill(native: Any, planes: Sequence[Any]) -> None:
    for plane, data in zip(native.planes, planes, strict=True):
        rows = np.frombuffer(plane, data.dtype).reshape(plane.height, -1)
        rows[:, : plane.width] = data


def write_clip(
    path: Path,
    frames: int = 12,
    *,
    codec: str = "libx264",
    pixel_format: str = "yuv420p",
    pts: Sequence[int] | None = None,
    time_base: Fraction = Fraction(1, 25),
    rate: Fraction = Fraction(25),
    size: tuple[int, int] = SIZE,
    options: dict[str, str] | None = None,
    tags: tuple[int, int, int, int] | None = (1, 1, 1, 1),
    audio_s: float = 0.0,
    audio_codec: str = "aac",
    rotation: int = 0,
    container_options: dict[str, str] | None = None,
    camera_data: Sequence[bytes] = (),
) -> Path:
    """Encode moving planes; tags: range, matrix, primaries, transfer (H.273). audio_s: length of a tone, in AAC, or in
    stereo in 16-bit PCM. camera_data: payloads of a GoPro's metadata track, one a second."""
    bits = 10 if "10le" in pixel_format else 8
    subsampling = next(kind for kind in ("444", "422", "420") if kind in pixel_format)
    quiet = {"x265-params": "log-level=none"} if codec == "libx265" else {}
    scale = str(time_base.denominator)
    timing = {"movie_timescale": scale, "video_track_timescale": scale} if path.suffix in (".mp4", ".mov") else {}
    with av.open(str(path), "w", options={**timing, **(container_options or {})}) as container:
        stream = container.add_stream(codec, rate=rate, options={**quiet, **(options or {})})
        context = stream.codec_context
        context.width, context.height = size
        context.pix_fmt, context.time_base = pixel_format, time_base
        if tags is not None:
            context.color_range, context.colorspace, context.color_primaries, context.color_trc = tags
        if rotation:
            stream.set_display_rotation(rotation)
        layout = "mono" if audio_codec == "aac" else "stereo"
        sound = container.add_stream(audio_codec, rate=48000, layout=layout) if audio_s else None
        data = container.add_data_stream("bin_data") if camera_data else None
        if data is not None:
            data.metadata["handler_name"], data.time_base = "GoPro MET", Fraction(1, 1000)
        for index in range(frames):
            native = av.VideoFrame(*size, pixel_format)
            fill(native, moving_planes(index, bits, subsampling, size))
            native.pts = pts[index] if pts is not None else index
            native.time_base = time_base
            container.mux(stream.encode(native))
        container.mux(stream.encode(None))
        if sound is not None:
            wave = np.sin(2 * np.pi * 440 * np.arange(int(audio_s * 48000)) / 48000).astype(np.float32)
            kind = "fltp" if audio_codec == "aac" else "s16"
            tracks = wave[None] if kind == "fltp" else np.repeat((32767 * wave).astype(np.int16), 2)[None]
            width = tracks.size // wave.size
            for start in range(0, wave.size, 1024):
                part = tracks[:, start * width : (start + 1024) * width]
                block = av.AudioFrame.from_ndarray(part, kind, layout)
                block.sample_rate, block.pts, block.time_base = 48000, start, Fraction(1, 48000)
                container.mux(sound.encode(block))
            container.mux(sound.encode(None))
        for second, payload in enumerate(camera_data):
            packet = av.Packet(payload)
            packet.stream, packet.time_base, packet.duration = data, Fraction(1, 1000), 1000
            packet.pts = packet.dts = 1000 * second
            container.mux(packet)
    return path


def write_trimmed_clip(
    path: Path, frames: int = 24, size: tuple[int, int] = SIZE
) -> tuple[Path, list[tuple[int, list[np.ndarray]]]]:
    """Write a clip with sound, cut as cameras and editors do: edit lists hide 3 frames and 640 samples at the start.

    Returns the path and what a decoder shows of the whole clip, frames + 3 pictures.
    """
    count = frames + 3
    pts = [1001 * k for k in range(count)]
    ntsc = Fraction(30000, 1001)
    write_clip(path, count, pts=pts, time_base=1 / (ntsc * 1001), rate=ntsc, size=size, audio_s=count / float(ntsc))
    whole = decoded(path)
    assert len(whole) == count
    shift_edit_list(path, 2913, 2913)  # not at the edge of a frame
    shift_edit_list(path, 640, 400, b"soun")
    return path, whole


def decoded(path: Path) -> list[tuple[int, list[np.ndarray]]]:
    """(pts, planes) of all frames, decoded by PyAV alone."""
    frames = []
    with av.open(str(path)) as container:
        for native in container.decode(video=0):
            dtype = np.uint16 if "10le" in native.format.name else np.uint8
            planes = []
            for plane in native.planes:
                rows = np.frombuffer(plane, dtype).reshape(plane.height, -1)
                planes.append(rows[:, : plane.width].copy())
            frames.append((native.pts, planes))
    return frames


def packets(path: Path, kind: str) -> list[tuple[int, int, bytes]]:
    """(pts, dts, data) of all packets of the first stream of a kind."""
    with av.open(str(path)) as container:
        stream = getattr(container.streams, kind)[0]
        return [(p.pts, p.dts, bytes(p)) for p in container.demux(stream) if p.dts is not None]


def exr_windows(origin: tuple[int, int], size: tuple[int, int], frame: tuple[int, int]) -> dict[str, Any]:
    """Return the header entries of an EXR whose pixels lie at an origin (column, row) of a frame."""
    low = np.array(origin, np.int32)
    inside, whole = (low, low + np.array(size, np.int32) - 1), (np.zeros(2, np.int32), np.array(frame, np.int32) - 1)
    return {"dataWindow": inside, "displayWindow": whole}
