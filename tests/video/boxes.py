# SPDX-License-Identifier: Apache-2.0
"""Boxes of MP4 files as other tools write them, byte by byte: the tests' own idea of the format.

Spherical metadata after Google's "Spherical Video RFC" (V1) and "Spherical Video V2 RFC", laid out as Google's injector
and FFmpeg do; edit lists after ISO/IEC 14496-12.
"""

from __future__ import annotations

import struct
from pathlib import Path
from uuid import UUID

XML = (
    '<?xml version="1.0"?><rdf:SphericalVideo\nxmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"\n'
    'xmlns:GSpherical="http://ns.google.com/videos/1.0/spherical/">'
    "<GSpherical:Spherical>true</GSpherical:Spherical><GSpherical:Stitched>true</GSpherical:Stitched>"
    "<GSpherical:StitchingSoftware>another tool</GSpherical:StitchingSoftware>"
    "<GSpherical:ProjectionType>equirectangular</GSpherical:ProjectionType>{stereo}</rdf:SphericalVideo>"
)
HEADERS = {b"stsd": 16, b"avc1": 86}
"""Bytes before the first box inside, where they are not 8."""


def box(kind: bytes, *content: bytes) -> bytes:
    """Return a box."""
    body = b"".join(content)
    return struct.pack(">I4s", 8 + len(body), kind) + body


def full_box(kind: bytes, *content: bytes) -> bytes:
    """Return a box of version 0 without flags."""
    return box(kind, bytes(4), *content)


def children(data: bytes, start: int, end: int) -> list[tuple[bytes, int, int]]:
    """Return (kind, start, end) of the boxes that lie between two places."""
    found = []
    while start < end:
        size, kind = struct.unpack_from(">I4s", data, start)
        found.append((kind, start, start + size))
        start += size
    return found


def changed(data: bytes, trail: list[bytes], change, track: bytes = b"vide") -> bytes:
    """Return the file with the content of one box, that at the end of `trail` in the track of a kind, changed.

    The media must lie before the index, for what lies behind a grown box moves.
    """

    def rebuilt(data: bytes, start: int, end: int, trail: list[bytes]) -> bytes:
        head = start + HEADERS.get(data[start + 4 : start + 8], 8)
        if not trail:
            body = data[start + 8 : head] + change(data[head:end])
        else:
            _, a, b = next(
                c for c in children(data, head, end)
                if c[0] == trail[0] and (c[0] != b"trak" or track in data[c[1] : c[2]])
            )  # fmt: skip
            body = data[start + 8 : a] + rebuilt(data, a, b, trail[1:]) + data[b:end]
        return box(data[start + 4 : start + 8], body)

    boxes = children(data, 0, len(data))
    _, start, end = next(c for c in boxes if c[0] == b"moov")
    assert next(c for c in boxes if c[0] == b"mdat")[1] < start
    return data[:start] + rebuilt(data, start, end, trail) + data[end:]


def mark_v1(path: Path, stereo: str = "", first_view: tuple[int, int] | None = None, **more: int) -> Path:
    """Add XML as the last box of the video track; stereo: "top-bottom", ... or nothing. first_view: heading, pitch.

    more: other elements.
    """
    said = {"StereoMode": stereo} if stereo else {}
    if first_view is not None:
        said |= {"InitialViewHeadingDegrees": str(first_view[0]), "InitialViewPitchDegrees": str(first_view[1])}
    said |= {name: str(number) for name, number in more.items()}
    xml = XML.format(stereo="".join(f"<GSpherical:{name}>{text}</GSpherical:{name}>" for name, text in said.items()))
    uuid = box(b"uuid", UUID("ffcc8263-f855-4a93-8814-587a02521fdd").bytes, xml.encode())
    path.write_bytes(changed(path.read_bytes(), [b"trak"], lambda content: content + uuid))
    return path


def sv3d(tool: bytes) -> bytes:
    """Return the box of a level full sphere."""
    pose, sphere = full_box(b"prhd", bytes(12)), full_box(b"equi", bytes(16))
    return box(b"sv3d", full_box(b"svhd", tool, b"\0"), box(b"proj", pose, sphere))


def mark_v2(path: Path, stereo_mode: int | None = None, layout: str = "google") -> Path:
    """Add boxes to the sample entry: at its end as Google's injector does, or behind 'avcC' as FFmpeg does."""
    stereo = b"" if stereo_mode is None else full_box(b"st3d", bytes([stereo_mode]))

    def with_boxes(content: bytes) -> bytes:
        at = children(content, 0, len(content))[0][2] if layout == "ffmpeg" else len(content)
        return content[:at] + stereo + sv3d(b"another tool") + content[at:]

    entry = [b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"avc1"]
    path.write_bytes(changed(path.read_bytes(), entry, with_boxes))
    return path


def shift_edit_list(path: Path, later: int, shorter: int, track: bytes = b"vide") -> Path:
    """Let the only edit of a track begin `later` [track ticks] in the media and last `shorter` [movie ticks] less."""

    def shifted(content: bytes) -> bytes:
        count, duration, start, rate = struct.unpack_from(">4xIIii", content)
        assert count == 1
        return content[:4] + struct.pack(">IIii", 1, duration - shorter, start + later, rate)

    path.write_bytes(changed(path.read_bytes(), [b"trak", b"edts", b"elst"], shifted, track))
    return path
