# SPDX-License-Identifier: Apache-2.0
"""Marks a JPEG or PNG as a panorama: XMP of Google's "Photo Sphere XMP Metadata" in the bytes of the picture."""

from __future__ import annotations

import struct
import zlib

_RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
_GPANO = "http://ns.google.com/photos/1.0/panorama/"
_JPEG_START = b"\xff\xd8"
_JPEG_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_XMP = b"XML:com.adobe.xmp\0\0\0\0\0"  # keyword, not compressed, no language
_PNG_HEADER_END = 33  # signature and the IHDR chunk


def xmp(width: int, height: int) -> bytes:
    """Return the XMP of a full equirectangular panorama."""
    values = {
        "ProjectionType": "equirectangular",
        "UsePanoramaViewer": "True",
        "FullPanoWidthPixels": width,
        "FullPanoHeightPixels": height,
        "CroppedAreaImageWidthPixels": width,
        "CroppedAreaImageHeightPixels": height,
        "CroppedAreaLeftPixels": 0,
        "CroppedAreaTopPixels": 0,
    }
    attributes = " ".join(f'GPano:{name}="{value}"' for name, value in values.items())
    return (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/">'
        f'<rdf:RDF xmlns:rdf="{_RDF}"><rdf:Description rdf:about="" xmlns:GPano="{_GPANO}" {attributes}/></rdf:RDF>'
        "</x:xmpmeta>"
    ).encode()


def marked(picture: bytes, width: int, height: int) -> bytes:
    """Return the bytes of a JPEG or PNG with the mark of a full panorama; other kinds come back unchanged."""
    if picture.startswith(_JPEG_START):
        body = _JPEG_XMP + xmp(width, height)
        return _JPEG_START + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + picture[2:]
    if picture.startswith(_PNG_START):
        body = b"iTXt" + _PNG_XMP + xmp(width, height)
        chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
        return picture[:_PNG_HEADER_END] + chunk + picture[_PNG_HEADER_END:]
    return picture
