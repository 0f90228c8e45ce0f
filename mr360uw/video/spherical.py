# SPDX-License-Identifier: Apache-2.0
"""Spherical video metadata, by which players recognise a 360 degree panorama.

V1: XML in a 'uuid' box of the video track (Google, "Spherical Video RFC"); V2: 'st3d' and 'sv3d' boxes of the sample
entry (Google, "Spherical Video V2 RFC"). Files are written with both, because some players read only V1; where they
differ on reading, V2 is taken and the difference is noted in `problems`. Other containers are read through FFmpeg.

Pictures are marked by XMP, see `picture_tags`.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal
from uuid import UUID

from mr360uw.errors import VideoError
from mr360uw.shapes import checked
from mr360uw.video.mp4 import Box, edit_moov, read_moov, sample_entries, video_track

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
    v1 = next((from_xml(b.payload[16:]) for b in track.children if _is_v1(b)), None)
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


def from_xml(data: bytes) -> SphericalMetadata:
    """Return the metadata in V1 XML."""
    if b"<!" in data:  # no document types, hence no entities to expand
        return SphericalMetadata(source="V1", problems=("V1 holds XML with declarations; not read",))
    try:
        root = ET.fromstring(data.strip(b"\0 \r\n\t").decode("utf-8", "replace"))  # noqa: S314 - see above
    except ET.ParseError as error:
        return SphericalMetadata(source="V1", problems=(f"V1 holds no valid XML ({error})",))
    said = {element.tag.rpartition("}")[2]: (element.text or "").strip() for element in root.iter()}

    def number(name: str) -> float:
        try:
            return float(said.get(name, "") or 0.0)
        except ValueError:
            return 0.0

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
    st3d, sv3d = entry.find(b"st3d"), entry.find(b"sv3d")
    if st3d is None and sv3d is None:
        return None
    mode = st3d.payload[4] if st3d is not None and len(st3d.payload) > 4 else 0
    stereo = _STEREO_V2[mode] if mode < len(_STEREO_V2) else "custom"
    if sv3d is None:
        return SphericalMetadata(stereo=stereo, source="V2", problems=("V2 has 'st3d' but no 'sv3d'",))
    problems = () if sv3d.find(b"svhd") else ("V2 has no 'svhd', which players may refuse",)
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
    return [
        Box(b"st3d", full + bytes([_STEREO_V2.index(metadata.stereo)])),
        Box(b"sv3d", children=[svhd, proj]),
    ]


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
    return from_xml(xml.encode()) if xml else None
