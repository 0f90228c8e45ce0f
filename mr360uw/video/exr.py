# SPDX-License-Identifier: Apache-2.0
"""Reads and writes OpenEXR pictures: RGB plates, maps, layered results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.errors import VideoError
from mr360uw.files import whole_file
from mr360uw.types import Floats
from mr360uw.video.read.exr_header import check_exr

REC709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
"""x, y of red, green, blue and white (ITU-R BT.709-6): the primaries of all linear light here."""
Compression = Literal["none", "zips", "zip", "piz", "dwaa", "dwab"]
Part = Mapping[str, NDArray[Any]]
"""Channels by name, float16, float32 or uint32: "RGB" or "RGBA" (H, W, 3 or 4), "Z" or "N.X" (H, W); an array (H, W, 3)
of another name, as "diffuse", is diffuse.R, diffuse.G, diffuse.B in the file."""


def read_exr(path: str | Path) -> dict[str, dict[str, NDArray[Any]]]:
    """Return the channels of all parts, {part: {channel: array}}, as they are stored (negative samples too).

    A part without a name is called by its number. Channels R, G, B, (A) of a layer come as one array (H, W, 3 or 4)
    called "RGB" or "RGBA", or by the layer's name. Raises `VideoError`.
    """
    import OpenEXR

    path = Path(path)
    check_exr(path)
    try:
        file = OpenEXR.File(str(path))
    except (RuntimeError, ValueError, TypeError, IndexError, OSError) as error:
        raise VideoError(f"{path} - is not an EXR file that can be read (got {error}) - write it again") from error
    with file:
        if not file.parts or not all(part.channels for part in file.parts):
            raise VideoError(f"{path} - is damaged (its pixels cannot be read) - copy or write it again")
        return {
            part.name() or str(number): {name: channel.pixels for name, channel in part.channels.items()}
            for number, part in enumerate(file.parts)
        }


def read_rgb(path: str | Path, *, depth: bool = False) -> NDArray[np.float32]:
    """Return the colour of an EXR's first part as linear RGB, (H, W, 3) float32, alpha left out.

    depth: rather the channel Z of any part, three times, where there is one.
    """
    parts = read_exr(path)
    found = next((channels["Z"] for channels in parts.values() if "Z" in channels), None) if depth else None
    if found is not None:
        return np.repeat(np.asarray(found, np.float32)[..., None], 3, axis=-1)
    channels = next(iter(parts.values()))
    for name in ("RGBA", "RGB"):
        if name in channels:
            return np.ascontiguousarray(channels[name][..., :3], np.float32)
    if "Y" in channels:
        return np.repeat(np.asarray(channels["Y"], np.float32)[..., None], 3, axis=-1)
    raise VideoError(f"{path} - has no colour channels R, G, B (got {', '.join(sorted(channels))}) - write them")


def _one_part(image: Floats) -> Mapping[str, Part]:
    array = np.asarray(image)
    return {"": {"RGBA"[: array.shape[-1] if array.ndim == 3 else 1]: array}}


def _checked(where: str, values: Any) -> NDArray[Any]:
    """Return a channel as a contiguous array; raise `VideoError` where it is no picture."""
    array = np.asarray(values)
    if array.dtype not in (np.float16, np.float32, np.uint32) or array.ndim not in (2, 3) or not array.size:
        raise VideoError(
            f"{where} - is no picture (got {array.dtype}, {array.shape}) - give float16, float32 or uint32, "
            "(H, W) or (H, W, 3)"
        )
    return np.ascontiguousarray(array)


def write_exr(
    path: str | Path,
    parts: Mapping[str, Part] | Floats,
    *,
    latlong: bool = True,
    compression: Compression = "zip",
    full_size: tuple[int, int] | None = None,
    origin: tuple[int, int] = (0, 0),
    attributes: Mapping[str, Any] | None = None,
    views: Mapping[str, str] | None = None,
    folder: Path | None = None,
) -> None:
    """Write one or more parts as an OpenEXR file, by a temporary name and a rename.

    parts: {part: {channel: array}}, or one linear image (H, W, 3 or 4). float16 channels are stored as half, float32
    as float. latlong: mark it as a latitude-longitude environment map. full_size: (width, height) of the frame
    that the arrays are a window of, whose top left pixel is `origin` = (column, row); by default the arrays are the
    frame. attributes: more header entries (numbers, strings). views: of parts that show
    what one eye sees, "left" or "right". folder: of the temporary file; default: that of `path`.
    """
    import OpenEXR

    path = Path(path)
    image_parts = parts if isinstance(parts, Mapping) else _one_part(parts)
    if not (image_parts and all(image_parts.values())):
        raise VideoError(f"{path} - has no channels (got none) - give an array for each")
    kind = "NO" if compression == "none" else compression.upper()
    header: dict[str, Any] = {
        "compression": getattr(OpenEXR, f"{kind}_COMPRESSION"),
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709,
        **(attributes or {}),
    }
    if latlong:
        header["envmap"] = OpenEXR.ENVMAP_LATLONG
    made = []
    for name, channels in image_parts.items():
        arrays = {channel: _checked(f"{path} {channel}", array) for channel, array in channels.items()}
        height, width = next(iter(arrays.values())).shape[:2]
        own = dict(header)
        if views is not None and name in views:
            own["view"] = views[name]
        if full_size is not None:
            column, row = origin
            low = np.array([column, row], np.int32)
            own["dataWindow"] = (low, low + np.array([width - 1, height - 1], np.int32))
            own["displayWindow"] = (np.zeros(2, np.int32), np.array(full_size, np.int32) - 1)
        made.append(OpenEXR.Part(own, arrays, name) if name else OpenEXR.Part(own, arrays))
    try:
        with whole_file(path, folder=folder) as part:
            OpenEXR.File(made).write(str(part))
    except (RuntimeError, ValueError, OSError) as error:
        raise VideoError(
            f"{path} - cannot be written (got {error}) - check the folder, its rights and the space"
        ) from error
