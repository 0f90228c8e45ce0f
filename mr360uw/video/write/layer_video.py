# SPDX-License-Identifier: Apache-2.0
"""The layer alone as a video with alpha: EXR layers of a composite as Apple ProRes 4444, for editors that read no EXR.

Colours are the layer's, linear Rec.709 with the water in front, encoded as sRGB, the curve by which plates are read,
and tagged BT.709. Alpha is linear. Straight: the codes are those of the colour itself. Premultiplied: those codes times
alpha, so that an editor lays codes over codes. Light without coverage, as of shafts, is premultiplied only.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import av
import av.error
import numpy as np
from av.video.reformatter import ColorRange, Colorspace
from numpy.typing import NDArray

from mr360uw.color import encode
from mr360uw.errors import VideoError
from mr360uw.files import new_file, publish
from mr360uw.output_gate import check_outputs
from mr360uw.reading.input_files import FRAMES
from mr360uw.reading.numbered_files import is_pattern, matching_files
from mr360uw.shapes import checked
from mr360uw.types import Floats
from mr360uw.video.clip import checked_rate
from mr360uw.video.exr import read_exr
from mr360uw.video.metadata.spherical import SphericalMetadata, write_spherical
from mr360uw.video.metadata.tags import BT709_TAGS
from mr360uw.video.read.probe import create_local

Alpha = Literal["straight", "premultiplied"]

_ENCODER, _PIXEL_FORMAT = "prores_ks", "yuva444p10le"
_OPTIONS = {"profile": "4444", "alpha_bits": "16"}
_PEAK = 65535


@checked
def layer_video(
    layers: str | Path,
    path: str | Path,
    *,
    alpha: Alpha = "straight",
    frame_rate: Fraction | float = 30,
    eye: Literal["left", "right"] | None = None,
    overwrite: bool = False,
) -> tuple[int, int]:
    """Write EXR layers as a video with alpha, ProRes 4444 in a .mov; return (frames, those of them without a file).

    layers: the pattern that `composite --layers` was given. A number without a file, between the first and the last,
    is a transparent frame. alpha: straight or premultiplied. frame_rate: frames a second. eye: of layers of two eyes.
    VideoError where the layers cannot be read or the video cannot be written.
    """
    layers, path = Path(layers), Path(path)
    files = dict(matching_files(layers)) if is_pattern(layers) else {}
    if not files or layers.suffix.lower() != ".exr":
        raise VideoError(f"{layers} - names no numbered EXR files - give the pattern of --layers, as layers_%04d.exr")
    rate = checked_rate(frame_rate, path)
    if path.suffix.lower() != ".mov":
        raise VideoError(f"{path} - ProRes with alpha is a .mov (got {path.suffix}) - name it {path.stem}.mov")
    check_outputs([path], inputs=[layers], overwrite=overwrite)
    first, last = min(files), max(files)
    FRAMES.check(f"{layers} frames", last - first + 1, VideoError)  # before a range, whose length has 63 bits
    numbers = range(first, last + 1)
    part = new_file(path)
    try:
        _encode(part, [files.get(number) for number in numbers], alpha, rate, eye)
        write_spherical(part, SphericalMetadata(), front=True)
        publish(part, path, overwrite=overwrite)
    except (av.error.FFmpegError, OSError) as error:
        raise VideoError(
            f"{path} - cannot be written (got {error}) - check the space and the folder's rights"
        ) from error
    finally:
        part.unlink(missing_ok=True)
    return len(numbers), len(numbers) - len(files)


def _encode(part: Path, files: list[Path | None], alpha: Alpha, rate: Fraction, eye: str | None) -> None:
    size: tuple[int, int] | None = None
    first = next(file for file in files if file is not None)
    with create_local(part, "mov") as container:
        stream = container.add_stream(_ENCODER, rate=rate, options=_OPTIONS)
        context = stream.codec_context
        for index, file in enumerate(files):
            rgba = _rgba(first if file is None else file, eye)
            if size is None:
                size = (rgba.shape[1], rgba.shape[0])
                context.width, context.height = size
                context.pix_fmt, context.time_base = _PIXEL_FORMAT, 1 / rate
                BT709_TAGS.write_to(context)
            if (rgba.shape[1], rgba.shape[0]) != size:
                raise VideoError(
                    f"{file} - differs from the first layer (got {rgba.shape[1]}x{rgba.shape[0]}) - name one run's"
                )
            codes = layer_codes(rgba if file is not None else np.zeros_like(rgba), alpha)
            native = av.VideoFrame.from_ndarray(codes, format="rgba64le")
            native = native.reformat(
                format=_PIXEL_FORMAT, dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
            )
            native.pts, native.time_base = index, 1 / rate
            container.mux(stream.encode(native))
        container.mux(stream.encode(None))


def layer_codes(rgba: Floats, alpha: Alpha) -> NDArray[np.uint16]:
    """Return 16-bit codes (H, W, 4) of premultiplied linear light and alpha (H, W, 4)."""
    cover = np.clip(rgba[..., 3:], 0.0, 1.0).astype(np.float64)
    covered = cover > 0.0
    light = np.where(covered, rgba[..., :3] / np.where(covered, cover, 1.0), rgba[..., :3])
    codes = encode(np.clip(light, 0.0, 1.0), "srgb")
    codes = codes * np.where(covered, cover, 1.0) if alpha == "premultiplied" else np.where(covered, codes, 0.0)
    return np.round(np.concatenate([codes, cover], axis=-1) * _PEAK).astype(np.uint16)


def _rgba(file: Path, eye: str | None) -> NDArray[Any]:
    parts = read_exr(file)
    name = "rgba" if eye is None else f"rgba.{eye}"
    if name not in parts or "RGBA" not in parts[name]:
        eyes = [part for part in parts if part.startswith("rgba.")]
        todo = "name an eye, left or right" if eyes and eye is None else "give the layers of `composite --layers`"
        raise VideoError(f"{file} - has no part {name} (got {', '.join(list(parts)[:6])}) - {todo}")
    return np.asarray(parts[name]["RGBA"], np.float32)
