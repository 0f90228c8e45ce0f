# SPDX-License-Identifier: Apache-2.0
"""Pictures and videos as people have them: what their files say is used, kept in outputs, or said."""

from __future__ import annotations

import hashlib
import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

import mr360uw as uw
from mr360uw.base.color import decode
from mr360uw.errors import VideoError
from mr360uw.from_above.aerial_picture import floor_of
from mr360uw.from_above.settings import AerialFloorSettings, AerialWaterSettings
from mr360uw.scene.model import PlateSettings
from mr360uw.scene.resolved import pose_of_plate
from mr360uw.video import read_picture, write_exr
from mr360uw.video.spherical import Box, edit_moov, video_track
from tests.video import tolerances as tol
from tests.video.clips import write_clip
from tests.video.test_picture_files import ACESCG, ADOBE, REC709_FROM_D50, gamma, icc, light, png, profiled

XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description rdf:about="" xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" {}/></rdf:RDF></x:xmpmeta>'
)
POSED = XMP.format('GPano:ProjectionType="equirectangular" GPano:PosePitchDegrees="7"').encode()


def codes() -> NDArray[np.uint8]:
    return np.rint(light() * 255).astype(np.uint8)


def notes_of(path: Path, **asked: Any) -> str:
    with uw.open_video(path, **asked) as video:
        return "\n".join(video.notes)


def segment(marker: int, body: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(body) + 2) + body


def jpeg(path: Path, *segments: bytes) -> Path:
    out = io.BytesIO()
    Image.fromarray(codes()).save(out, "JPEG", quality=95)
    path.write_bytes(out.getvalue()[:2] + b"".join(segments) + out.getvalue()[2:])
    return path


def segments_of(path: Path) -> list[tuple[int, bytes]]:
    """Return the segments of a JPEG before its pixels."""
    data, at, found = path.read_bytes(), 2, []
    while data[at + 1] != 0xDA:
        size = struct.unpack_from(">H", data, at + 2)[0]
        found.append((data[at + 1], data[at + 4 : at + 2 + size]))
        at += 2 + size
    return found


def chunks_of(path: Path) -> list[tuple[bytes, bytes]]:
    data, at, found = path.read_bytes(), 8, []
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        found.append((kind, data[at + 8 : at + 8 + size]))
        at += 12 + size
    return found


IPTC = segment(0xED, b"Photoshop 3.0\x008BIM\x04\x04\0\0\0\0\0\x08\x1c\x02\x19\0\x03abc")
COMMENT = segment(0xFE, b"dive 12")


def extended(body: bytes) -> list[bytes]:
    """Return the segments of XMP that does not fit into one."""
    digest = hashlib.md5(body).hexdigest().upper()
    main = XMP.format(f'xmlns:xmpNote="http://ns.adobe.com/xmp/note/" xmpNote:HasExtendedXMP="{digest}"').encode()
    parts = [
        segment(
            0xE1,
            b"http://ns.adobe.com/xmp/extension/\0"
            + digest.encode()
            + struct.pack(">II", len(body), at)
            + body[at : at + 60000],
        )
        for at in range(0, len(body), 60000)
    ]
    return [segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + main), *parts]


def test_iptc_comments_and_extended_xmp_are_carried_or_said(tmp_path: Path) -> None:
    """Field by field: a JPEG's own segments come back as they were; where they cannot, a line names them."""
    more = extended(POSED + b" " * 70000)
    source = jpeg(tmp_path / "in.jpg", *more, IPTC, COMMENT)
    assert pose_of_plate(PlateSettings(path=source)) == (0.0, 7.0, 0.0)
    uw.video.transcode(source, tmp_path / "out.jpg")
    assert [one for one in segments_of(tmp_path / "out.jpg") if one[0] in (0xE1, 0xED, 0xFE)] == [
        one for one in segments_of(source) if one[0] in (0xE1, 0xED, 0xFE)
    ]
    with uw.open_video(source) as video, uw.video.create_video(tmp_path / "out.png", video) as out:
        out.write(next(video.frames()))
    assert any(".png does not hold the plate's extended XMP and IPTC and comment" in note for note in out.notes)


@pytest.mark.parametrize("kind", ["tEXt", "zTXt", "iTXt"])
def test_texts_of_a_png_are_carried_or_said(tmp_path: Path, kind: str) -> None:
    text = {"tEXt": b"Author\0me", "zTXt": b"Author\0\0" + zlib.compress(b"me"), "iTXt": b"Author\0\0\0de\0\0me"}[kind]
    (tmp_path / "in.png").write_bytes(png(codes(), (kind.encode(), text)))
    uw.video.transcode(tmp_path / "in.png", tmp_path / "out.png")
    assert (kind.encode(), text) in chunks_of(tmp_path / "out.png")
    with uw.open_video(tmp_path / "in.png") as video, uw.video.create_video(tmp_path / "out.tif", video) as out:
        out.write(next(video.frames()))
    assert any(".tif does not hold the plate's texts - a .png keeps them" in note for note in out.notes)


def test_metadata_of_a_jpeg_stand_behind_fill_bytes_too(tmp_path: Path) -> None:
    """Any marker may have fill bytes, 0xFF, before it (ITU-T T.81, B.1.1.2)."""
    exif = Image.Exif()
    exif[272] = "a camera"
    held = io.BytesIO()
    Image.fromarray(codes()).save(held, "JPEG", exif=exif)
    data = held.getvalue()
    (tmp_path / "plate.jpg").write_bytes(data[:2] + b"\xff\xff" + data[2:])
    with uw.open_video(tmp_path / "plate.jpg") as video:
        assert video.picture_tags is not None
        assert b"a camera" in video.picture_tags.exif


def test_iptc_of_a_tiff_is_carried(tmp_path: Path) -> None:
    tags = ImageFileDirectory_v2()
    tags.tagtype[33723] = 1
    tags[33723] = b"\x1c\x02\x19\0\x03abc"
    Image.fromarray(codes()).save(tmp_path / "in.tif", tiffinfo=tags)
    uw.video.transcode(tmp_path / "in.tif", tmp_path / "out.tif")
    with Image.open(tmp_path / "out.tif") as picture:
        assert bytes(picture.tag_v2[33723]) == b"\x1c\x02\x19\0\x03abc"
    assert np.array_equal(read_picture(tmp_path / "out.tif"), codes())


def test_metadata_in_texts_of_older_programs_are_read(tmp_path: Path) -> None:
    """ImageMagick writes XMP and EXIF of a PNG as hexadecimal digits."""
    digits = b"\nxmp\n%8d\n%s\n" % (len(POSED), POSED.hex().encode())
    (tmp_path / "in.png").write_bytes(png(codes(), (b"zTXt", b"Raw profile type xmp\0\0" + zlib.compress(digits))))
    assert pose_of_plate(PlateSettings(path=tmp_path / "in.png")) == (0.0, 7.0, 0.0)


def tiff(path: Path, pixels: NDArray[Any], **how: Any) -> Path:
    """Write a TIFF, plane after plane or with tags that the library does not write."""
    tags, planes = how.get("tags", {}), how.get("planes", False)
    data = np.moveaxis(pixels, -1, 0).tobytes() if planes else pixels.tobytes()
    height, width, count = pixels.shape
    entries = {
        256: (4, width), 257: (4, height), 259: (3, 1), 262: (3, 2), 277: (3, count), 278: (4, height),
        284: (3, 2 if planes else 1), 339: (3, {"u": 1, "f": 3}[pixels.dtype.kind]), 258: (3, 8 * pixels.itemsize),
        **({338: (3, 2)} if count == 4 else {}), **tags,
    }  # fmt: skip
    each = len(data) // count
    lists = {258: [8 * pixels.itemsize] * count, 339: [entries[339][1]] * count}
    lists |= {273: [8 + each * k for k in range(count)], 279: [each] * count} if planes else {}
    entries |= {} if planes else {273: (4, 8), 279: (4, len(data))}
    body, at = b"", 8 + len(data) + 2 + 12 * len(entries | lists) + 4
    rows = []
    for tag in sorted(entries | lists):
        kind, values = (entries[tag][0], [entries[tag][1]]) if tag in entries and tag not in lists else (
            (3, lists[tag]) if tag in (258, 339) else (4, lists[tag]))  # fmt: skip
        form = "<" + ("H" if kind == 3 else "I") * len(values)
        packed = struct.pack(form, *values)
        if len(packed) > 4:
            rows.append(struct.pack("<HHII", tag, kind, len(values), at + len(body)))
            body += packed
        else:
            rows.append(struct.pack("<HHI", tag, kind, len(values)) + packed.ljust(4, b"\0"))
    head = b"II*\0" + struct.pack("<I", 8 + len(data)) + data
    path.write_bytes(head + struct.pack("<H", len(rows)) + b"".join(rows) + bytes(4) + body)
    return path


def test_tiffs_are_read_however_they_are_stored(tmp_path: Path) -> None:
    """Plane after plane, and with alpha that is not multiplied in, of floats too."""
    floats = np.dstack([light(), np.full(light().shape[:2], 0.5, np.float32)])
    assert np.array_equal(read_picture(tiff(tmp_path / "floats.tif", floats)), light())
    assert "has transparency" in notes_of(tmp_path / "floats.tif")
    clear = np.dstack([codes(), np.full(codes().shape[:2], 100, np.uint8)])
    assert np.array_equal(read_picture(tiff(tmp_path / "planes.tif", codes(), planes=True)), codes())
    assert np.array_equal(read_picture(tiff(tmp_path / "clear.tif", clear)), codes())
    assert "has transparency" in notes_of(tmp_path / "clear.tif")


@pytest.mark.parametrize(
    ("name", "says"),
    [("planes", "planar"), ("half", "floats of 16 bits"), ("double", "floats of 64 bits"), ("cmyk", "CMYK"),
     ("lab", r"L\*a\*b\*"), ("five", "5 channels of 8 bits"), ("raw", "camera raw"), ("zip", "number 50000"),
     ("big", "BigTIFF")],
)  # fmt: skip
def test_tiffs_that_are_not_read_say_what_they_are(tmp_path: Path, name: str, says: str) -> None:
    path, deep = tmp_path / "a.tif", codes().astype(np.uint16) * 257
    more: dict[str, Callable[[], Any]] = {
        "planes": lambda: tiff(path, deep, planes=True), "half": lambda: tiff(path, light().astype(np.float16)),
        "double": lambda: tiff(path, light().astype(np.float64)),
        "cmyk": lambda: tiff(path, np.dstack([codes(), codes()[..., :1]]), tags={262: (3, 5)}),
        "lab": lambda: tiff(path, codes(), tags={262: (3, 8)}), "raw": lambda: tiff(path, deep, tags={262: (3, 34892)}),
        "five": lambda: tiff(path, np.dstack([codes(), codes()[..., :2]])),
        "zip": lambda: tiff(path, deep, tags={259: (3, 50000)}), "big": lambda: path.write_bytes(b"II+\0" + bytes(60)),
    }  # fmt: skip
    more[name]()
    with pytest.raises(VideoError, match=says):
        uw.open_video(path)


@pytest.mark.parametrize(
    ("chunks", "says"),
    [(((b"cICP", bytes([1, 13, 0, 0])),), "video range"), (((b"tRNS", bytes(6)),), "has transparency")],
)
def test_chunks_of_a_png_that_are_not_used_are_said(
    tmp_path: Path, chunks: tuple[tuple[bytes, bytes], ...], says: str
) -> None:
    (tmp_path / "a.png").write_bytes(png(codes(), *chunks))
    assert says in notes_of(tmp_path / "a.png")


def test_parts_of_jpegs_that_are_not_used_are_said(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif.get_ifd(34665)[40961] = 65535
    body = b"Exif\0\0" + exif.tobytes().removeprefix(b"Exif\0\0")
    assert "not sRGB, and has no profile" in notes_of(jpeg(tmp_path / "a.jpg", segment(0xE1, body)))
    eye = XMP.format('xmlns:GImage="http://ns.google.com/photos/1.0/image/" GImage:Mime="image/jpeg"').encode()
    said = notes_of(jpeg(tmp_path / "b.jpg", segment(0xE1, b"http://ns.adobe.com/xap/1.0/\0" + eye)))
    assert "right eye, depth or sound in its XMP" in said


def test_exr_headers_are_followed_or_said(tmp_path: Path) -> None:
    """Colour spaces by their names; alpha; pixels that are not square. X, Y and Z are no luminance."""
    path = tmp_path / "a.exr"
    write_exr(path, light(), attributes={"chromaticities": ACESCG})
    with uw.open_video(path) as video:
        expected = next(video.frames()).image_linear

    def written(header: dict[str, Any], channels: dict[str, Any]) -> str:
        head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
        OpenEXR.File(head, channels).write(str(path))
        return notes_of(path)

    assert written({"colorInteropID": "lin_ap1_scene"}, {"RGB": light()}) == ""
    with uw.open_video(path) as video:
        np.testing.assert_allclose(next(video.frames()).image_linear, expected, atol=tol.PROFILE)
    assert "names a space that is not known (got 'mystery')" in written({"colorInteropID": "mystery"}, {"RGB": light()})
    assert "pixels are not square (got 2)" in written({"pixelAspectRatio": 2.0}, {"RGB": light()})
    planes = {name: np.ascontiguousarray(light()[..., k]) for k, name in enumerate("RGB")}
    assert "has transparency" in written({}, planes | {"A": np.full(light().shape[:2], 0.5, np.float32)})
    with pytest.raises(VideoError, match=r"no colour channels R, G, B \(got X, Y, Z\)"):
        written({}, dict(zip("XYZ", planes.values(), strict=True)))


def test_radiance_pictures_of_every_age(tmp_path: Path) -> None:
    """Runs as the first versions wrote them, lines that end as in DOS, a gamma, and other endings of the name."""
    row = np.repeat(np.array([(200, 40, 40, 128), (40, 200, 40, 129)], np.uint8), 32, axis=0)
    plain = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 32 +X 64\n" + row.tobytes() * 32
    (tmp_path / "plain.hdr").write_bytes(plain)
    expected = read_picture(tmp_path / "plain.hdr")
    runs = b"".join(bytes(row[k]) + bytes([1, 1, 1, 31]) for k in (0, 32))
    head, _, body = plain.partition(b"-Y 32 +X 64\n")
    for name, data in (
        ("old.hdr", head + b"-Y 32 +X 64\n" + runs * 32),
        ("dos.hdr", head.replace(b"\n", b"\r\n") + b"-Y 32 +X 64\r\n" + body),
        ("a.pic", plain),
        ("photoshop.hdr", plain.replace(b"FORMAT", b"GAMMA=1\nPRIMARIES=0 0 0 0 0 0 0 0\nFORMAT")),
    ):
        (tmp_path / name).write_bytes(data)
        assert np.array_equal(read_picture(tmp_path / name), expected), name
        assert notes_of(tmp_path / name) == ""
    (tmp_path / "gamma.hdr").write_bytes(plain.replace(b"FORMAT", b"GAMMA=2.2\nFORMAT"))
    assert "names a gamma (got 2.2), which is not used" in notes_of(tmp_path / "gamma.hdr")


@pytest.mark.parametrize(
    ("name", "data", "says"),
    [
        ("a.png", b"version https://git-lfs.github.com/spec/v1\noid", "git lfs pull"),
        ("a.jpg", b"<html>404</html>", "download the file again"), ("a.exr", b"PK\3\4" + bytes(60), "unpack it"),
        ("a.mp4", b"version https://git-lfs.github.com/spec/v1\noid", "git lfs pull"),
        ("a.mp4", bytes(2000), "begins with zeros"), ("a.mp4", b"\xff\xd8\xff\xe0" + bytes(60), "name end in .jpg"),
        ("a.braw", b"x" * 60, "DaVinci Resolve"), ("a.ppm", b"P6 2 1 255 " + bytes(6), "kind that is not read"),
        ("a.png", b"\xff\x0a" + bytes(60), "kind that is not read"),
    ],
)  # fmt: skip
def test_what_is_no_plate_is_told(tmp_path: Path, name: str, data: bytes, says: str) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(VideoError, match=says):
        uw.open_video(tmp_path / name)


def test_cubes_are_answered_with_their_filter(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "cube.png"), np.zeros((64, 96, 3), np.uint8))
    with pytest.raises(VideoError, match=r"six faces of a cube, turn it by ffmpeg -i cube.png -vf v360=c3x2:e"):
        uw.open_video(tmp_path / "cube.png")


def test_names_of_sequences(tmp_path: Path) -> None:
    """Houdini's pattern; a number that is there twice; widths as of two sequences in one folder."""
    for name in ("a.1001.png", "a.1002.png", "b_1.png", "b_01.png", "c_0009.png", "c_010.png", "d_9.png", "d_10.png"):
        cv2.imwrite(str(tmp_path / name), codes())
    with uw.open_video(tmp_path / "a.$F4.png") as video, uw.video.create_video(tmp_path / "out.$F6.png", video) as out:
        assert (video.frame_count, video.first_number, video.notes) == (2, 1001, ())
        for frame in video.frames():
            out.write(frame)
    assert sorted(file.name for file in tmp_path.glob("out*")) == ["out.001001.png", "out.001002.png"]
    with pytest.raises(VideoError, match=r"number 1 twice \(got b_01.png and b_1.png\)"):
        uw.open_video(tmp_path / "b_%d.png")
    assert "several widths of its numbers (as c_0009.png and c_010.png)" in notes_of(tmp_path / "c_%04d.png")
    assert notes_of(tmp_path / "d_%d.png") == ""


def clip(path: Path, size: tuple[int, int] = (128, 64), aspect: int = 1, **options: str) -> Path:
    """Write two grey frames of H.264."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"qp": "0", **options})
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.codec_context.sample_aspect_ratio = aspect
        for number in range(2):
            frame = av.VideoFrame.from_ndarray(np.full((size[1] * 3 // 2, size[0]), 90, np.uint8), format="yuv420p")
            frame.pts = number
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(
    ("option", "says"),
    [("colorprim=smpte432", "primaries that are not used (got Display P3)"), ("transfer=linear", "(got linear)"),
     ("transfer=log100", "(got logarithmic)"), ("interlaced=1", "is interlaced")],
)  # fmt: skip
def test_tags_of_a_clip_that_are_not_followed_are_said(tmp_path: Path, option: str, says: str) -> None:
    assert says in notes_of(clip(tmp_path / "a.mp4", **{"x264-params": option}))


def test_shapes_of_pixels_are_followed_or_said(tmp_path: Path) -> None:
    """A square frame that is shown as 2:1 is one panorama, not two eyes; a frame of 2:1 is the whole sphere."""
    with uw.open_video(clip(tmp_path / "a.mp4", (64, 64), 2)) as video:
        assert (video.width, video.height, video.stereo) == (64, 64, "mono")
    assert "pixels are not square (got 2)" in notes_of(clip(tmp_path / "b.mp4", aspect=2))


def test_mirrored_clips_and_previews(tmp_path: Path) -> None:
    """A display matrix may mirror, which is no turn by 180 degrees."""
    path = write_clip(tmp_path / "a.mp4", 2)
    (tmp_path / "a.lrv").write_bytes(path.read_bytes())
    assert "small preview" in notes_of(tmp_path / "a.lrv")

    def mirror(moov: Box) -> None:
        track = video_track(moov)
        assert track is not None
        head = track.find(b"tkhd")
        assert head is not None
        payload = bytearray(head.payload)
        struct.pack_into(">9i", payload, 40, -65536, 0, 0, 0, 65536, 0, 0, 0, 1 << 30)
        head.payload = bytes(payload)

    edit_moov(path, mirror, False)
    with pytest.raises(VideoError, match="as in a mirror"):
        uw.open_video(path)


def test_pictures_of_a_scene_from_above_are_read_by_their_profile(tmp_path: Path) -> None:
    (tmp_path / "sand.png").write_bytes(
        png(np.full((32, 32, 3), (150, 120, 90), np.uint8), profiled(icc(ADOBE, gamma(2.0))))
    )
    floor = AerialFloorSettings(ground="picture", picture=tmp_path / "sand.png", albedo=1.0)
    found = floor_of(floor, AerialWaterSettings(mode="koschmieder")).mean_albedo
    expected = (np.array([150, 120, 90]) / 255.0) ** 2.0 @ (REC709_FROM_D50 @ ADOBE).T
    np.testing.assert_allclose(found, expected, atol=tol.PROFILE)
    assert abs(expected - decode(np.array([150, 120, 90]) / 255.0, "srgb")).max() > 0.01
