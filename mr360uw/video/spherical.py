# SPDX-License-Identifier: Apache-2.0
"""Spherical video metadata, by which players recognise a 360 degree panorama, in the boxes of MP4 files.

V1: XML in a 'uuid' box of the video track (Google, "Spherical Video RFC"); V2: 'st3d' and 'sv3d' boxes of the sample
entry (Google, "Spherical Video V2 RFC"). Files are written with both, because some players read only V1; where they
differ on reading, V2 is taken and the difference is noted in `problems`. Other containers are read through FFmpeg.

Pictures are marked by XMP, see `picture_tags`.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO, Literal
from uuid import UUID

import numpy as np

from mr360uw.base.parameters import checked
from mr360uw.errors import VideoError
from mr360uw.video.picture_tags import number_of

_RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
Stereo = Literal["mono", "top-bottom", "bottom-top", "left-right", "right-left", "custom"]

V1_TAG = "SPHERICAL-VIDEO"
"""Name of the tag that holds V1 XML in Matroska and WebM."""
_V1_UUID = UUID("ffcc8263-f855-4a93-8814-587a02521fdd").bytes
_GSPHERICAL = "http://ns.google.com/videos/1.0/spherical/"
_FIRST_VIEW = ("InitialViewHeadingDegrees", "InitialViewPitchDegrees", "InitialViewRollDegrees")
_SOFTWARE = "mr360uw"
_STEREO_V2: tuple[Stereo, ...] = ("mono", "top-bottom", "left-right", "custom", "right-left")
_STEREO_FFMPEG: dict[int, Stereo] = {0: "mono", 1: "left-right", 2: "top-bottom"}
_PROJECTION_FFMPEG = {0: "equirectangular", 1: "cubemap", 2: "equirectangular", 3: "half equirectangular"}
_PROJECTION_V2 = {b"equi": "equirectangular", b"cbmp": "cubemap", b"mshp": "mesh"}


@dataclass(frozen=True, slots=True)
class SphericalMetadata:
    """Projection, stereo layout and bounds of a panorama, as stated in a file.

    projection: "equirectangular", "cubemap", "mesh" ... stereo: arrangement of the eyes. pose_deg: yaw, pitch, roll
    by which players rotate the sphere (V2): a pitch lifts its centre, a roll turns it clockwise. view_deg: heading,
    pitch, roll of what a viewer sees first (V1), which rotates nothing. bounds: fractions cut off at the top, bottom,
    left and right; zeros for the full sphere. source: where it was found ("V1", "V2", "V1+V2", "side data"). problems:
    contradictions in the file, one line each.
    """

    projection: str = "equirectangular"
    stereo: Stereo = "mono"
    pose_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    view_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bounds: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    source: str = ""
    problems: tuple[str, ...] = ()

    @property
    def is_half(self) -> bool:
        """Whether the bounds are those of the half of the sphere in front (VR180)."""
        return all(abs(one - half) < 0.01 for one, half in zip(self.bounds, (0.0, 0.0, 0.25, 0.25), strict=True))


@checked
def read_spherical(path: str | Path) -> SphericalMetadata | None:
    """Return the spherical metadata in the boxes of an mp4 or mov file, None where there are none."""
    moov = read_moov(Path(path))
    track = video_track(moov) if moov is not None else None
    if track is None:
        return None
    v1 = next((_from_xml(b.payload[16:]) for b in track.children if _is_v1(b)), None)
    v2 = next((m for m in map(_from_entry, sample_entries(track)) if m is not None), None)
    if v1 is None or v2 is None:
        return v2 or v1
    problems = [
        f"V1 says {name} {getattr(v1, name)}, V2 says {getattr(v2, name)}; V2 is taken"
        for name in ("projection", "stereo", "bounds")
        if getattr(v1, name) != getattr(v2, name)
    ]
    return replace(v2, view_deg=v1.view_deg, source="V1+V2", problems=(*v1.problems, *v2.problems, *problems))


def _is_v1(box: Box) -> bool:
    return box.kind == b"uuid" and box.payload[:16] == _V1_UUID


def _from_xml(data: bytes) -> SphericalMetadata:
    """Return the metadata in V1 XML."""
    if b"<!" in data:  # no document types, hence no entities to expand
        return SphericalMetadata(source="V1", problems=("V1 holds XML with declarations; not read",))
    try:
        root = ET.fromstring(data.strip(b"\0 \r\n\t").decode("utf-8", "replace"))  # noqa: S314 - see above
    except ET.ParseError as error:
        return SphericalMetadata(source="V1", problems=(f"V1 holds no valid XML ({error})",))
    said = {element.tag.rpartition("}")[2]: (element.text or "").strip() for element in root.iter()}

    def number(name: str) -> float:
        return number_of(said.get(name, ""))

    stereo = said.get("StereoMode", "mono")
    full_width, full_height = number("FullPanoWidthPixels"), number("FullPanoHeightPixels")
    bounds = (0.0, 0.0, 0.0, 0.0)
    if full_width and full_height and number("CroppedAreaImageWidthPixels"):
        left, top = number("CroppedAreaLeftPixels") / full_width, number("CroppedAreaTopPixels") / full_height
        right = 1.0 - left - number("CroppedAreaImageWidthPixels") / full_width
        bottom = 1.0 - top - number("CroppedAreaImageHeightPixels") / full_height
        bounds = (top, bottom, left, right)
    return SphericalMetadata(
        projection=said.get("ProjectionType", "equirectangular"),
        stereo=stereo if stereo in _STEREO_V2 else "custom",
        view_deg=(number(_FIRST_VIEW[0]), number(_FIRST_VIEW[1]), number(_FIRST_VIEW[2])),
        bounds=bounds,
        source="V1",
    )


def _from_entry(entry: Box) -> SphericalMetadata | None:
    # Stereo by st3d; without sv3d the projection is not said
    st3d, sv3d = entry.find(b"st3d"), entry.find(b"sv3d")
    if st3d is None and sv3d is None:
        return None
    mode = st3d.payload[4] if st3d is not None and len(st3d.payload) > 4 else 0
    stereo = _STEREO_V2[mode] if mode < len(_STEREO_V2) else "custom"
    if sv3d is None:
        return SphericalMetadata(stereo=stereo, source="V2", problems=("V2 has 'st3d' but no 'sv3d'",))
    problems = () if sv3d.find(b"svhd") else ("V2 has no 'svhd', which players may refuse",)
    # Pose and bounds of the projection, in fixed point
    proj = sv3d.find(b"proj")
    pose = proj.find(b"prhd") if proj else None
    shape = next((b for b in proj.children if b.kind in _PROJECTION_V2), None) if proj else None
    angles = struct.unpack_from(">3i", pose.payload, 4) if pose and len(pose.payload) >= 16 else (0, 0, 0)
    bounds = struct.unpack_from(">4I", shape.payload, 4) if shape and shape.kind == b"equi" else (0, 0, 0, 0)
    return SphericalMetadata(
        projection=_PROJECTION_V2[shape.kind] if shape else "unknown",
        stereo=stereo,
        pose_deg=tuple(a / 65536.0 for a in angles),
        bounds=tuple(b / 2.0**32 for b in bounds),
        source="V2",
        problems=problems,
    )


def from_side_data(side_data: Any) -> SphericalMetadata | None:
    """Return the metadata that FFmpeg puts into the side data of a decoded frame, as of Matroska's Projection."""
    from av.sidedata.sidedata import Type

    stereo_data, sphere = side_data.get(Type.STEREO3D), side_data.get(Type.SPHERICAL)
    if sphere is None:
        return None
    projection, yaw, pitch, roll, left, top, right, bottom, _ = struct.unpack_from("=I3i5I", bytes(sphere))
    mode = struct.unpack_from("=I", bytes(stereo_data))[0] if stereo_data is not None else 0
    return SphericalMetadata(
        projection=_PROJECTION_FFMPEG.get(projection, f"number {projection}"),
        stereo=_STEREO_FFMPEG.get(mode, "custom"),
        pose_deg=(yaw / 65536.0, pitch / 65536.0, roll / 65536.0),
        bounds=(top / 2.0**32, bottom / 2.0**32, left / 2.0**32, right / 2.0**32),
        source="side data",
    )


def v1_xml(metadata: SphericalMetadata) -> str:
    """Return the V1 XML of full-sphere equirectangular metadata."""
    elements = {
        "Spherical": "true",
        "Stitched": "true",
        "StitchingSoftware": _SOFTWARE,
        "ProjectionType": "equirectangular",
        "StereoMode": metadata.stereo,
    }
    view = zip(_FIRST_VIEW, metadata.view_deg, strict=True)
    elements |= {name: str(round(angle)) for name, angle in view if round(angle)}
    body = "".join(f"<GSpherical:{name}>{text}</GSpherical:{name}>" for name, text in elements.items())
    return (
        f'<?xml version="1.0"?><rdf:SphericalVideo xmlns:rdf="{_RDF}" xmlns:GSpherical="{_GSPHERICAL}">'
        f"{body}</rdf:SphericalVideo>"
    )


def _v2_boxes(metadata: SphericalMetadata) -> list[Box]:
    full = bytes(4)  # version and flags
    pose = struct.pack(">3i", *(round(angle * 65536.0) for angle in metadata.pose_deg))
    proj = Box(b"proj", children=[Box(b"prhd", full + pose), Box(b"equi", full + bytes(16))])
    svhd = Box(b"svhd", full + _SOFTWARE.encode() + b"\0")
    return [Box(b"st3d", full + bytes([_STEREO_V2.index(metadata.stereo)])), Box(b"sv3d", children=[svhd, proj])]


def embed(moov: Box, metadata: SphericalMetadata) -> None:
    """Put V1 and V2 metadata of a full equirectangular sphere into the video track of a parsed 'moov' box."""
    track = video_track(moov)
    entries = sample_entries(track) if track is not None else []
    if track is None or not entries:
        raise VideoError("mp4 - has no video track to mark as spherical - name a video file")
    track.children = [box for box in track.children if not _is_v1(box)]
    track.children.append(Box(b"uuid", _V1_UUID + v1_xml(metadata).encode()))
    for entry in entries:
        entry.children = [box for box in entry.children if box.kind not in (b"st3d", b"sv3d")] + _v2_boxes(metadata)


@checked
def write_spherical(path: str | Path, metadata: SphericalMetadata, front: bool = False) -> None:
    """Mark an mp4 or mov file as a full-sphere panorama, V1 and V2, in place; earlier marks are replaced.

    front: also move the index to the front of the file ("fast start").
    """
    edit_moov(Path(path), lambda moov: embed(moov, metadata), front)


def from_tag(stream: Any) -> SphericalMetadata | None:
    """Return V1 metadata as Matroska and WebM hold it, in a tag of the track; None where there is none."""
    xml = next((text for key, text in stream.metadata.items() if key.upper() == V1_TAG), None)
    return _from_xml(xml.encode()) if xml else None


# The 'moov' box of MP4 and QuickTime files, read and edited (ISO/IEC 14496-12).

_CONTAINERS = {b"moov", b"trak", b"mdia", b"minf", b"stbl", b"sv3d", b"proj"}
_SAMPLE_ENTRY_HEAD = 78  # bytes of a VisualSampleEntry before its child boxes
_TAGS, _CHAPTERS = (b"udta", b"meta"), b"chpl"
_DEEPEST = 32
"""Most boxes within each other; a file of a camera has ten."""
_COPY_BYTES = 1 << 23
_OFFSET_LIMIT = 1 << 32


@dataclass(slots=True)
class Box:
    """A box: its four-letter kind, its payload up to the first child, and its children."""

    kind: bytes
    payload: bytes = b""
    children: list[Box] = field(default_factory=list)

    def find(self, *path: bytes) -> Box | None:
        """Return the first descendant on a path of kinds."""
        box: Box | None = self
        for kind in path:
            box = next((child for child in box.children if child.kind == kind), None) if box else None
        return box

    def serialised(self) -> bytes:
        """Return the bytes of the box."""
        body = self.payload + b"".join(child.serialised() for child in self.children)
        if len(body) + 8 < _OFFSET_LIMIT:
            return struct.pack(">I4s", len(body) + 8, self.kind) + body
        return struct.pack(">I4sQ", 1, self.kind, len(body) + 16) + body


_Extent = tuple[bytes, int, int]
"""A top-level box in the file: kind, offset, size."""


def _header(data: bytes, available: int) -> tuple[bytes, int, int] | None:
    """Return (kind, size of the header, size of the box), None where the bytes are no box."""
    if len(data) < 8:
        return None
    size, kind = struct.unpack_from(">I4s", data)
    if size == 1 and len(data) >= 16:
        return kind, 16, struct.unpack_from(">Q", data, 8)[0]
    if size == 0:
        return kind, 8, available
    return (kind, 8, size) if size >= 8 else None


def _extents(file: BinaryIO) -> Iterator[_Extent]:
    end = file.seek(0, 2)
    offset = 0
    while offset < end:
        file.seek(offset)
        header = _header(file.read(16), end - offset)
        if header is None:
            return
        yield header[0], offset, header[2]
        offset += header[2]


def cut_short(path: Path) -> str:
    """Return in what way an MP4 or QuickTime file ends early, in words; "" where it does not, or is another kind."""
    with path.open("rb") as file:
        extents = list(_extents(file))
        size = file.seek(0, 2)
    if not extents or extents[0][0] not in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"):
        return ""
    kind, offset, length = extents[-1]
    missing = offset + length - size
    if missing > 0 and kind != b"mdat":
        return f"its '{kind.decode('latin-1')}' index is incomplete"
    if all(kind != b"moov" for kind, _, _ in extents):
        return "it has no 'moov' index"
    return f"{missing} bytes are missing" if missing > 0 else ""


def parse_boxes(data: bytes) -> list[Box]:
    """Return the boxes in some bytes; containers and video sample entries are parsed into children."""
    boxes, rest = _split(data)
    if rest:
        raise ValueError("not a sequence of boxes")
    return boxes


def _split(data: bytes, depth: int = 0) -> tuple[list[Box], bytes]:
    boxes: list[Box] = []
    if depth > _DEEPEST:
        return boxes, data
    offset = 0
    while offset < len(data):
        header = _header(data[offset : offset + 16], len(data) - offset)
        if header is None or offset + header[2] > len(data):
            break
        kind, head, size = header
        boxes.append(_box(kind, data[offset + head : offset + size], depth))
        offset += size
    return boxes, data[offset:]


def _box(kind: bytes, body: bytes, depth: int) -> Box:
    """Return a box; its children are left in its payload where they are no boxes, or too deep."""
    head = 8 if kind == b"stsd" else 0
    if kind in _CONTAINERS or kind == b"stsd":
        children, rest = _split(body[head:], depth + 1)
        if not rest:
            return Box(kind, body[:head], children)
    return Box(kind, body)


def tracks_of(moov: Box, kind: bytes) -> Iterator[Box]:
    """Yield the tracks whose handler is of a kind: b"vide" for pictures, b"soun" for sound."""
    for track in moov.children:
        handler = track.find(b"mdia", b"hdlr")
        if track.kind == b"trak" and handler is not None and handler.payload[8:12] == kind:
            yield track


def video_track(moov: Box) -> Box | None:
    """Return the first track of pictures."""
    return next(tracks_of(moov, b"vide"), None)


def sample_table(track: Box) -> Box | None:
    """Return the box whose children are a track's sample entries."""
    return track.find(b"mdia", b"minf", b"stbl", b"stsd")


def sample_entries(track: Box) -> list[Box]:
    """Return a video track's sample entries with their child boxes parsed, in place."""
    table = sample_table(track)
    entries = table.children if table is not None else []
    for entry in entries:
        if not entry.children:
            children, rest = _split(entry.payload[_SAMPLE_ENTRY_HEAD:])
            if rest in (b"", bytes(4)):  # QuickTime may end the entry with four zero bytes
                entry.payload, entry.children = entry.payload[:_SAMPLE_ENTRY_HEAD], children
    return entries


def read_moov(path: Path) -> Box | None:
    """Return the parsed 'moov' box of a file, None where it has none."""
    with path.open("rb") as file:
        for extent in _extents(file):
            if extent[0] == b"moov":
                return _read_moov(file, extent)
    return None


def _read_moov(file: BinaryIO, extent: _Extent) -> Box | None:
    _, offset, size = extent
    file.seek(offset)
    boxes, _ = _split(file.read(size))
    return boxes[0] if boxes and boxes[0].children else None


def carry_tags(moov: Box, source: Box) -> None:
    """Put the tags of a file ('udta' and 'meta' of its movie) into another one's index, byte for byte.

    Cameras and phones keep there what no muxer has names for. Chapters ('chpl') stay those of the file that is written.
    """
    tags = [box for box in source.children if box.kind in _TAGS]
    if not tags:
        return
    own = [
        box for old in moov.children if old.kind == b"udta" for box in _split(old.payload)[0] if box.kind == _CHAPTERS
    ]
    if own and all(box.kind != b"udta" for box in tags):
        tags.append(Box(b"udta"))
    moov.children = [box for box in moov.children if box.kind not in _TAGS] + [_with_chapters(box, own) for box in tags]


def _with_chapters(tags: Box, chapters: list[Box]) -> Box:
    """Return tags with other chapters; as they are where they are no boxes, which QuickTime may end with four zeros."""
    boxes, rest = _split(tags.payload)
    if tags.kind != b"udta" or rest not in (b"", bytes(4)):
        return tags
    return Box(tags.kind, children=[box for box in boxes if box.kind != _CHAPTERS] + chapters)


def edit_moov(path: Path, edit: Callable[[Box], None], front: bool = False) -> None:
    """Change the 'moov' box of a file in place; the media data move as needed and all chunk offsets follow.

    edit: changes the parsed box. front: also move it before the media data, so that players can start while loading.
    Interrupted half way the file is broken: work on a copy. VideoError where the file is fragmented or has no 'moov'.
    """
    with path.open("r+b") as file:
        extents = list(_extents(file))
        index = next((i for i, extent in enumerate(extents) if extent[0] == b"moov"), None)
        moov = _read_moov(file, extents[index]) if index is not None else None
        if index is None or moov is None:
            raise VideoError(f"{path} - is not an mp4 or mov file with an index - remux it to mp4")
        if moov.find(b"mvex") or any(kind == b"moof" for kind, _, _ in extents):
            raise VideoError(f"{path} - is a fragmented mp4, its index cannot be edited - remux it to a plain mp4")
        edit(moov)
        old = extents[index]
        target = old[1]
        if front:
            target = min([*(offset for kind, offset, _ in extents if kind == b"mdat"), target])
        _replace(file, old, target, moov)


def _replace(file: BinaryIO, old: _Extent, target: int, moov: Box) -> None:
    """Take away the box at `old` and put the new one at `target`, not after it."""
    size, (_, old_offset, old_size) = len(moov.serialised()), old
    old_end = old_offset + old_size

    def moved(offsets: np.ndarray) -> np.ndarray:
        between = np.where((offsets >= target) & (offsets < old_offset), size, 0)
        return offsets + np.where(offsets >= old_end, size - old_size, between)

    shifted = _with_offsets(moov, moved, wide=False)
    if shifted is None:  # an offset no longer fits in 32 bits: 64-bit tables make the box larger
        size = len(_with_offsets(moov, lambda offsets: offsets, wide=True).serialised())  # type: ignore[union-attr]
        shifted = _with_offsets(moov, moved, wide=True)
    assert shifted is not None
    end = file.seek(0, 2)
    if size >= old_size:
        _move(file, old_end, end, size - old_size)
        _move(file, target, old_offset, size)
    else:
        _move(file, target, old_offset, size)
        _move(file, old_end, end, size - old_size)
    file.seek(target)
    file.write(shifted.serialised())
    file.truncate(end + size - old_size)


def _with_offsets(box: Box, moved: Callable[[np.ndarray], np.ndarray], wide: bool) -> Box | None:
    """Return a copy of the tree with all chunk offsets moved; None where one does not fit in 32 bits unless `wide`."""
    if box.kind in (b"stco", b"co64"):
        offsets = moved(np.frombuffer(box.payload[8:], ">u4" if box.kind == b"stco" else ">u8").astype(np.int64))
        if box.kind == b"co64" or wide:
            return Box(b"co64", box.payload[:8] + offsets.astype(">u8").tobytes())
        if offsets.size and offsets.max() >= _OFFSET_LIMIT:
            return None
        return Box(b"stco", box.payload[:8] + offsets.astype(">u4").tobytes())
    children = [_with_offsets(child, moved, wide) for child in box.children]
    if any(child is None for child in children):
        return None
    return Box(box.kind, box.payload, [child for child in children if child is not None])


def _move(file: BinaryIO, start: int, stop: int, shift: int) -> None:
    """Move the bytes [start, stop) of a file by `shift`, in pieces, in the order that overwrites nothing unread."""
    if not shift:
        return
    pieces = range(start, stop, _COPY_BYTES)
    for piece in reversed(pieces) if shift > 0 else pieces:
        file.seek(piece)
        data = file.read(min(_COPY_BYTES, stop - piece))
        file.seek(piece + shift)
        file.write(data)
