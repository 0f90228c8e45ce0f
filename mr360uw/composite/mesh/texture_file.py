# SPDX-License-Identifier: Apache-2.0
"""Reads image files as textures. Colour profiles and gamma tags are ignored, as glTF requires."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.mesh.texture import Texture, make_texture
from mr360uw.errors import MeshError
from mr360uw.reading.input_files import read_data
from mr360uw.reading.limits import TEXTURE
from mr360uw.reading.picture_size import picture_size

Pixels = NDArray[np.uint8] | NDArray[np.uint16]
_PNG = b"\x89PNG\r\n\x1a\n"
_PNG_DEPTH = 24
"""Byte offset of the bit depth in a PNG file."""
_BROKEN = (OSError, ValueError, IndexError, KeyError, TypeError, SyntaxError, OverflowError, EOFError, MemoryError)
"""What PIL raises where a file is damaged; UnidentifiedImageError is an OSError."""


def read_texture(path: Path, *, srgb: bool) -> Texture:
    """Return the texture of an image file; raise `MeshError`."""
    return make_texture(decode_image(read_data(path, MeshError), str(path)), srgb=srgb)


def check_image(data: bytes, where: str) -> None:
    """Raise `MeshError` where an image file cannot be opened or has too many pixels; it is not decoded."""
    with _opened(data, where):
        return


def decode_image(data: bytes, where: str) -> Pixels:
    """Return the code values (h, w, 3 or 4) of a PNG, JPEG, WebP ... file, uint8, or uint16 where it has 16 bits.

    Raises `MeshError`.
    """
    with _opened(data, where) as image:
        if data.startswith(_PNG) and data[_PNG_DEPTH] == 16:
            return _sixteen_bits(data)
        return pixels(image)


def decoded(image: Any, where: str) -> NDArray[np.uint8]:
    """Return an image that PIL has opened as (h, w, 3 or 4) uint8; raise `MeshError` where it is damaged."""
    try:
        return pixels(image)
    except _BROKEN as error:
        raise _unreadable(where, error) from error


def _unreadable(where: str, error: Exception) -> MeshError:
    what = str(error) or type(error).__name__
    return MeshError(f"{where} - a texture cannot be read (got: {what:.120}) - give a PNG or JPEG")


@contextmanager
def _opened(data: bytes, where: str) -> Iterator[Any]:
    """Yield an image file that PIL has opened, not decoded.

    Raises `MeshError` where it has too many pixels, and for what PIL and OpenCV raise, there and within.
    """
    import cv2
    from PIL import Image

    width, height = picture_size(data) or (0, 0)  # before PIL, which has a limit of its own
    TEXTURE.check(where, width * height, MeshError)
    try:
        with Image.open(io.BytesIO(data)) as image:
            TEXTURE.check(where, image.width * image.height, MeshError)
            yield image
    except MeshError:
        raise
    except (*_BROKEN, Image.DecompressionBombError, cv2.error) as error:
        raise _unreadable(where, error) from error


def pixels(image: Any) -> NDArray[np.uint8]:
    """Return a PIL image as (h, w, 3 or 4) uint8."""
    if image.mode.startswith("I"):  # PIL would clip 16-bit greys to 255 instead of scaling them
        grey = (np.asarray(image, np.float64) / 257.0 + 0.5).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=-1)
    clear = image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
    return np.asarray(image.convert("RGBA" if clear else "RGB"))


def _sixteen_bits(data: bytes) -> NDArray[np.uint16]:
    """Return a PNG of 16 bits, of which PIL keeps 8."""
    import cv2

    image: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError("a PNG of 16 bits that does not decode")
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=-1)
    return np.ascontiguousarray(image[..., [2, 1, 0, 3][: image.shape[2]]])
