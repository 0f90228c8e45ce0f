# SPDX-License-Identifier: Apache-2.0
"""Pictures of other programs and cameras: what their files say is used, kept in outputs, or said."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import mr360uw as uw
from mr360uw.base.color import LUMINANCE, decode, encode, rec709_from_chromaticities
from mr360uw.errors import ParameterError, VideoError
from mr360uw.preview.pages import save_still
from mr360uw.scene.model import PlateSettings
from mr360uw.scene.resolved import pose_of_plate
from mr360uw.video import VideoFrame, read_exr, read_picture, write_exr
from mr360uw.video.picture_tags import with_tags, xmp
from mr360uw.video.writer import write_picture
from mr360uw.yuv.file_profile import REC709_XY
from tests.video import tolerances as tol
from tests.video.clips import exr_windows

SIZE = (64, 32)
P3 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290)
ACESCG = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
GPANO = "http://ns.google.com/photos/1.0/panorama/"


def light(size: tuple[int, int] = SIZE) -> NDArray[np.float32]:
    """Return smooth colours within every gamut, darker towards the poles, whose edges meet."""
    lon = np.linspace(0.0, 2.0 * np.pi, size[0], endpoint=False)
    lat = np.linspace(0.2, np.pi - 0.2, size[1])[:, None]
    channels = [0.45 + 0.2 * np.cos(lon + k) * np.sin(lat) for k in range(3)]
    return np.stack(channels, axis=-1).astype(np.float32)


def s15(value: float) -> bytes:
    return struct.pack(">i", round(value * 65536.0))


def icc(xyz: NDArray[np.float64] | None, curve: bytes, *, name: str = "made here") -> bytes:
    """Return an ICC profile of a matrix (3, 3) to XYZ of D50, or of grey without one, and a curve's tag."""
    text = name.encode() + b"\0"
    tags = {b"desc": b"desc" + bytes(4) + struct.pack(">I", len(text)) + text + bytes(78)}
    tags[b"wtpt"] = b"XYZ \0\0\0\0" + s15(0.9642) + s15(1.0) + s15(0.8249)
    if xyz is None:
        tags[b"kTRC"] = curve
    else:
        for k, one in enumerate((b"r", b"g", b"b")):
            tags[one + b"XYZ"] = b"XYZ \0\0\0\0" + b"".join(s15(v) for v in xyz[:, k])
            tags[one + b"TRC"] = curve
    at, table, body = 132 + 12 * len(tags), b"", b""
    for tag, content in tags.items():
        padded = content + bytes(-len(content) % 4)
        table += struct.pack(">4sII", tag, at + len(body), len(content))
        body += padded
    head = struct.pack(
        ">I4s4s4s4s4s", at + len(body), bytes(4), b"\x02\x40\0\0", b"mntr", b"GRAY" if xyz is None else b"RGB ", b"XYZ "
    )
    head = head.ljust(36, b"\0") + b"acsp" + bytes(28) + s15(0.9642) + s15(1.0) + s15(0.8249)
    return head.ljust(128, b"\0") + struct.pack(">I", len(tags)) + table + body


# Columns are the colorants of Adobe RGB (1998) and ProPhoto, in XYZ adapted to D50 (as their profiles state)
ADOBE = np.array([(0.60974, 0.20528, 0.14919), (0.31111, 0.62567, 0.06322), (0.01947, 0.06087, 0.74457)])
PROPHOTO = np.array([(0.79767, 0.13519, 0.03134), (0.28804, 0.71188, 0.00009), (0.0, 0.0, 0.82491)])
# Rec.709 from XYZ of D50 by Bradford (ICC.1:2022, annex E; Lindbloom's tables)
REC709_FROM_D50 = np.array([
    (3.1338561, -1.6168667, -0.4906146), (-0.9787684, 1.9161415, 0.0334540), (0.0719453, -0.2289914, 1.4052427),
])  # fmt: skip


def gamma(value: float) -> bytes:
    return b"curv" + bytes(4) + struct.pack(">IH", 1, round(256 * value))


def table() -> bytes:
    """Return the curve of L*, as in profiles of cameras and scanners, in 1024 steps."""
    x = np.linspace(0.0, 1.0, 1024)
    y = np.where(x <= 0.08, x * 100.0 / 903.3, ((x + 0.16) / 1.16) ** 3)
    return b"curv" + bytes(4) + struct.pack(">I", 1024) + np.rint(y * 65535).astype(">u2").tobytes()


def lightness(x: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(x <= 0.08, x * 100.0 / 903.3, ((x + 0.16) / 1.16) ** 3)


PROFILES: dict[str, tuple[bytes, Callable[[Any], Any], NDArray[np.float64]]] = {
    "Adobe RGB": (icc(ADOBE, gamma(563 / 256)), lambda v: v ** (563 / 256), REC709_FROM_D50 @ ADOBE),
    "ProPhoto": (icc(PROPHOTO, gamma(1.8)), lambda v: v ** (round(256 * 1.8) / 256), REC709_FROM_D50 @ PROPHOTO),
    "camera": (icc(ADOBE, table()), lightness, REC709_FROM_D50 @ ADOBE),
    "grey": (icc(None, gamma(2.2)), lambda v: v ** (round(256 * 2.2) / 256), np.eye(3)),
}


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(codes: NDArray[Any], *chunks: tuple[bytes, bytes]) -> bytes:
    data = cv2.imencode(".png", codes[..., ::-1])[1].tobytes()
    return data[:33] + b"".join(chunk(*one) for one in chunks) + data[33:]


def profiled(data: bytes) -> tuple[bytes, bytes]:
    return b"iCCP", b"name\0\0" + zlib.compress(data)


@pytest.mark.parametrize("name", PROFILES)
def test_pictures_are_read_by_their_profile(name: str, tmp_path: Path) -> None:
    """16-bit codes lose nothing: the light is that of the profile's own formulas, to single precision."""
    data, curve, matrix = PROFILES[name]
    codes = np.rint(light() * 65535).astype(np.uint16)
    codes = np.repeat(codes[..., :1], 3, axis=-1) if name == "grey" else codes
    (tmp_path / "plate.png").write_bytes(png(codes, profiled(data)))
    with uw.open_video(tmp_path / "plate.png") as video:
        frame = next(video.frames())
    expected = curve(codes / 65535.0) @ matrix.T
    np.testing.assert_allclose(frame.image_linear, expected, atol=tol.PROFILE)
    assert np.abs(frame.image_linear - decode(codes / 65535.0, "srgb")).max() > 0.005


CHUNKS: dict[str, tuple[tuple[bytes, bytes], Callable[[Any], Any], tuple[float, ...]]] = {
    "Display P3": ((b"cICP", bytes([12, 13, 0, 1])), lambda v: decode(v, "srgb"), P3),
    "gamma": ((b"gAMA", struct.pack(">I", 100000)), lambda v: v, REC709_XY),
    "primaries": (
        (b"cHRM", struct.pack(">8I", *(round(1e5 * v) for v in (*P3[6:], *P3[:6])))), lambda v: decode(v, "srgb"), P3
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CHUNKS)
def test_pngs_are_read_by_their_chunks_and_keep_them(name: str, tmp_path: Path) -> None:
    stated, curve, xy = CHUNKS[name]
    codes = np.rint(light() * 255).astype(np.uint8)
    (tmp_path / "plate.png").write_bytes(png(codes, stated))
    with uw.open_video(tmp_path / "plate.png") as video:
        frame = next(video.frames())
    matrix = rec709_from_chromaticities(np.reshape(xy, (4, 2)))
    np.testing.assert_allclose(frame.image_linear, curve(codes / 255.0) @ matrix.T, atol=tol.PROFILE)
    uw.video.transcode(tmp_path / "plate.png", tmp_path / "out.png")
    written = (tmp_path / "out.png").read_bytes()
    assert chunk(*stated) in written
    np.testing.assert_array_equal(read_picture(tmp_path / "out.png"), codes)
    # A JPEG cannot hold these chunks: it gets what a display of sRGB shows
    uw.video.transcode(tmp_path / "plate.png", tmp_path / "out.jpg")
    shown = encode(np.clip(frame.image_linear, 0.0, 1.0), "srgb") * 255.0
    assert np.median(np.abs(read_picture(tmp_path / "out.jpg") - shown)) < tol.JPEG_CODES


def test_high_dynamic_range_of_a_png_is_read(tmp_path: Path) -> None:
    (tmp_path / "plate.png").write_bytes(png(np.full((32, 64, 3), 38055, np.uint16), (b"cICP", bytes([9, 16, 0, 1]))))
    with uw.open_video(tmp_path / "plate.png") as video:
        white = next(video.frames()).image_linear
    np.testing.assert_allclose(white, 1.0, rtol=0.01)  # 58 % of PQ is HDR reference white (BT.2408-7, table 1)


def test_what_a_profile_says_gives_way_to_the_scene_with_a_word(tmp_path: Path) -> None:
    codes = np.rint(light() * 255).astype(np.uint8)
    (tmp_path / "plate.png").write_bytes(png(codes, profiled(PROFILES["Adobe RGB"][0])))
    with uw.open_video(tmp_path / "plate.png", transfer="linear") as video:
        assert any("plate.transfer" in note for note in video.notes)
        np.testing.assert_allclose(next(video.frames()).image_linear, codes / 255.0, atol=tol.PROFILE)
    for broken in (b"nonsense" * 40, PROFILES["Adobe RGB"][0][:150]):
        (tmp_path / "plate.png").write_bytes(png(codes, profiled(broken)))
        with uw.open_video(tmp_path / "plate.png") as video:
            assert any("cannot be used" in note and "sRGB" in note for note in video.notes)


EXIF = Image.Exif()
EXIF[271], EXIF[272], EXIF[306] = "RICOH", "THETA Z1", "2024:05:01 10:00:00"
EXIF[0x8769] = {0x9003: "2024:05:01 09:59:59", 0x829A: 0.008}
EXIF[0x8825] = {1: "N", 2: (20.0, 30.0, 0.0), 3: "W", 4: (87.0, 12.0, 0.0)}
XMP = (
    f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    f'<rdf:Description rdf:about="" xmlns:GPano="{GPANO}" GPano:ProjectionType="equirectangular" '
    'GPano:FullPanoWidthPixels="64" GPano:FullPanoHeightPixels="32" GPano:CroppedAreaImageWidthPixels="64" '
    'GPano:CroppedAreaImageHeightPixels="32" GPano:CroppedAreaLeftPixels="0" GPano:CroppedAreaTopPixels="0" '
    'GPano:PosePitchDegrees="12" GPano:PoseRollDegrees="-8" GPano:InitialViewHeadingDegrees="90"/></rdf:RDF>'
    "</x:xmpmeta>"
).encode()


def save(path: Path, codes: NDArray[np.uint8], exif: Image.Exif, xmp: bytes, profile: bytes) -> None:
    """Write a picture by Pillow, with metadata."""
    options: dict[str, Any] = {"exif": exif.tobytes(), "icc_profile": profile}
    if path.suffix == ".tif":
        from PIL.TiffImagePlugin import ImageFileDirectory_v2

        more = ImageFileDirectory_v2()
        more[700] = xmp
        for tag in (271, 272, 306):
            more[tag] = exif[tag]
        more[0x8769], more[0x8825] = exif[0x8769], exif[0x8825]
        options = {"tiffinfo": more, "icc_profile": profile}
    elif path.suffix == ".png":
        from PIL.PngImagePlugin import PngInfo

        text = PngInfo()
        text.add_itxt("XML:com.adobe.xmp", xmp.decode())
        options["pnginfo"] = text
    else:
        options["xmp"] = xmp
    Image.fromarray(codes).save(path, **options, **({"lossless": True} if path.suffix == ".webp" else {}))


def fields(path: Path) -> dict[str, Any]:
    """Return the metadata of a picture as Pillow reads them."""
    with Image.open(path) as picture:
        said, xmp = picture.getexif(), picture.info.get("xmp") or picture.info.get("XML:com.adobe.xmp") or b""
        found = {
            "icc": picture.info.get("icc_profile"), "xmp": xmp.encode() if isinstance(xmp, str) else xmp,
            "exif": {tag: said.get(tag) for tag in (271, 272, 306)},
            "taken": dict(said.get_ifd(0x8769)), "gps": dict(said.get_ifd(0x8825)),
        }  # fmt: skip
        if path.suffix == ".tif":
            found["xmp"] = bytes(picture.tag_v2.get(700, b""))
        return found


KINDS = (".jpg", ".png", ".tif", ".webp")


@pytest.mark.parametrize("source", KINDS)
@pytest.mark.parametrize("target", KINDS)
def test_profile_exif_and_mark_are_carried_over(source: str, target: str, tmp_path: Path) -> None:
    """Field by field, in every pair of kinds that hold them; codes are the plate's where both are lossless."""
    codes = np.rint(light() * 255).astype(np.uint8)
    save(tmp_path / f"plate{source}", codes, EXIF, XMP, PROFILES["Adobe RGB"][0])
    before, out = fields(tmp_path / f"plate{source}"), tmp_path / f"out{target}"
    uw.video.transcode(tmp_path / f"plate{source}", out)
    assert fields(out) == before
    assert before["icc"] == PROFILES["Adobe RGB"][0]
    assert before["xmp"] == XMP
    assert before["gps"][4] == (87.0, 12.0, 0.0)
    if ".jpg" not in (source, target):
        np.testing.assert_array_equal(read_picture(out), codes)


def test_exif_goes_into_the_header_of_exr_files_and_other_losses_are_said(tmp_path: Path) -> None:
    import OpenEXR

    codes = np.rint(light() * 255).astype(np.uint8)
    save(tmp_path / "plate.jpg", codes, EXIF, XMP, b"")
    uw.video.transcode(tmp_path / "plate.jpg", tmp_path / "out.exr")
    with OpenEXR.File(str(tmp_path / "out.exr")) as file:
        header = dict(file.header())
    assert (header["cameraMake"], header["capDate"]) == ("RICOH", "2024:05:01 09:59:59")
    np.testing.assert_allclose([header["latitude"], header["longitude"]], [20.5, -87.2], rtol=tol.HALF)
    with uw.open_video(tmp_path / "plate.jpg") as video, uw.video.create_video(tmp_path / "out.bmp", video) as out:
        out.write(next(video.frames()))
        assert any(".bmp does not hold the plate's EXIF" in note for note in out.notes)


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "webp"])
def test_the_tilt_of_a_marked_panorama_is_the_level_of_the_camera(suffix: str, tmp_path: Path) -> None:
    save(tmp_path / f"plate.{suffix}", np.rint(light() * 255).astype(np.uint8), EXIF, XMP, b"")
    assert pose_of_plate(PlateSettings(path=tmp_path / f"plate.{suffix}"))[1:] == (12.0, -8.0)


@pytest.mark.parametrize("turned", range(1, 9))
def test_orientation_is_applied_once(turned: int, tmp_path: Path) -> None:
    codes = np.rint(light() * 255).astype(np.uint8)
    # What has to be stored for the picture to be seen upright, by Pillow's own way back
    undo = {2: 0, 3: 3, 4: 1, 5: 5, 6: 2, 7: 6, 8: 4}  # Image.Transpose
    stored = Image.fromarray(codes) if turned == 1 else Image.fromarray(codes).transpose(Image.Transpose(undo[turned]))
    exif = Image.Exif()
    exif[274] = turned
    stored.save(tmp_path / "plate.png", exif=exif.tobytes())
    np.testing.assert_array_equal(read_picture(tmp_path / "plate.png"), codes)
    uw.video.transcode(tmp_path / "plate.png", tmp_path / "out.png")
    np.testing.assert_array_equal(read_picture(tmp_path / "out.png"), codes)
    with Image.open(tmp_path / "out.png") as out:
        assert out.size == SIZE
        assert out.getexif().get(274, 1) == 1


def test_a_part_of_a_panorama_is_placed_and_written_as_it_was(tmp_path: Path) -> None:
    codes, whole = np.rint(light() * 255).astype(np.uint8), (128, 64)
    xmp = XMP.replace(b'FullPanoWidthPixels="64"', b'FullPanoWidthPixels="128"')
    xmp = xmp.replace(b'FullPanoHeightPixels="32"', b'FullPanoHeightPixels="64"')
    xmp = xmp.replace(b'LeftPixels="0"', b'LeftPixels="16"').replace(b'TopPixels="0"', b'TopPixels="8"')
    save(tmp_path / "plate.png", codes, EXIF, xmp, b"")
    with uw.open_video(tmp_path / "plate.png") as video:
        frame = next(video.frames())
        assert (video.width, video.height) == whole
        assert any("a part of a panorama of 128x64" in note for note in video.notes)
    np.testing.assert_array_equal(frame.rgb[8:40, 16:80], codes)
    assert int(frame.rgb.sum()) == int(codes.sum())
    uw.video.transcode(tmp_path / "plate.png", tmp_path / "out.png")
    np.testing.assert_array_equal(read_picture(tmp_path / "out.png"), codes)
    assert fields(tmp_path / "out.png")["xmp"] == xmp
    save(tmp_path / "plate.png", codes, EXIF, xmp.replace(b'LeftPixels="16"', b'LeftPixels="100"'), b"")
    with pytest.raises(VideoError, match="cannot be"):
        uw.open_video(tmp_path / "plate.png")


def test_primaries_of_an_exr_are_converted_and_kept(tmp_path: Path) -> None:
    import OpenEXR

    values = light()
    header = {"chromaticities": ACESCG, "owner": "me", "adoptedNeutral": np.array([0.32168, 0.33767], np.float32)}
    write_exr(tmp_path / "plate.exr", values, attributes=header)
    with uw.open_video(tmp_path / "plate.exr") as video:
        frame = next(video.frames())
    matrix = rec709_from_chromaticities(np.reshape(ACESCG, (4, 2)))
    np.testing.assert_allclose(frame.image_linear, values @ matrix.T, atol=tol.PROFILE)
    np.testing.assert_allclose(matrix @ np.ones(3), 1.0, atol=1e-12)
    # The usual matrix from ACEScg to linear Rec.709, its white adapted by Bradford
    published = [(1.70505, -0.62179, -0.08326), (-0.13026, 1.14080, -0.01055), (-0.02400, -0.12897, 1.15297)]
    np.testing.assert_allclose(matrix, published, atol=1e-4)
    uw.video.transcode(tmp_path / "plate.exr", tmp_path / "out.exr")
    np.testing.assert_array_equal(read_exr(tmp_path / "out.exr")["0"]["RGB"], values)
    with OpenEXR.File(str(tmp_path / "out.exr")) as file:
        said = dict(file.header())
    np.testing.assert_allclose(said["chromaticities"], ACESCG, rtol=1e-6)
    np.testing.assert_allclose(said["adoptedNeutral"], ACESCG[6:], rtol=1e-6)
    assert said["owner"] == "me"
    # In a PNG it is what a display of sRGB shows
    uw.video.transcode(tmp_path / "plate.exr", tmp_path / "out.png")
    shown = encode(np.clip(frame.image_linear, 0.0, 1.0), "srgb") * 65535.0
    assert np.abs(read_picture(tmp_path / "out.png") - shown).max() <= 1.0


WINDOWS = {"smaller": ((8, 4), (48, 24)), "larger": ((-4, -2), (72, 36)), "beside": ((-8, 6), (40, 20))}


@pytest.mark.parametrize("name", WINDOWS)
def test_the_display_window_is_the_panorama(name: str, tmp_path: Path) -> None:
    (column, row), (width, height) = WINDOWS[name]
    part = light((width, height)) + 1.0
    windows = exr_windows((column, row), (width, height), frame=SIZE)
    write_exr(tmp_path / "plate.exr", part, attributes=windows)
    with uw.open_video(tmp_path / "plate.exr") as video:
        got = next(video.frames()).image_linear
        assert any("data window" in note for note in video.notes)
    around = np.zeros((96, 192, 3), np.float32)
    around[32 + row :, 64 + column :][:height, :width] = part
    np.testing.assert_array_equal(got, around[32:64, 64:128])


NAMES: dict[str, tuple[dict[str, Any], str]] = {
    "Blender": ({"": {"ViewLayer.Combined": 1, "ViewLayer.Depth.Z": 0, "ViewLayer.Normal": 3}}, "ViewLayer.Combined"),
    "parts": ({"depth": {"Z": 0}, "rgba": {"RGBA": 1}}, "rgba"),
    "Nuke": ({"": {"diffuse": 2, "rgba.red": 0, "rgba.green": 0, "rgba.blue": 0}}, "rgba"),
    "several": ({"": {"RGB": 1, "diffuse": 2, "specular": 3}}, "R, G, B"),
}


@pytest.mark.parametrize("name", NAMES)
def test_the_layer_of_the_picture_is_found_and_named(name: str, tmp_path: Path) -> None:
    parts, taken = NAMES[name]
    arrays = {
        part: {
            key: np.full((32, 64), 1.0, np.float32)
            if not value
            else np.full((32, 64, 4 if key == "RGBA" else 3), value, np.float32)
            for key, value in channels.items()
        }
        for part, channels in parts.items()
    }
    write_exr(tmp_path / "plate.exr", arrays)
    with uw.open_video(tmp_path / "plate.exr") as video:
        np.testing.assert_array_equal(next(video.frames()).image_linear, 1.0)
        (note,) = video.notes
    assert f"by its layer {taken}" in note


def luma_chroma(path: Path, y: NDArray[Any], red: NDArray[Any], blue: NDArray[Any]) -> None:
    """Write an uncompressed EXR of luminance and chroma of half the size."""

    def entry(name: str, kind: str, data: bytes) -> bytes:
        return f"{name}\0{kind}\0".encode() + struct.pack("<I", len(data)) + data

    height, width = y.shape
    channels = b"".join(n + b"\0" + struct.pack("<iBxxxii", 1, 0, s, s) for n, s in ((b"BY", 2), (b"RY", 2), (b"Y", 1)))
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    head = struct.pack("<II", 20000630, 2) + entry("channels", "chlist", channels + b"\0")
    head += entry("compression", "compression", b"\0") + entry("dataWindow", "box2i", box)
    head += entry("displayWindow", "box2i", box) + entry("lineOrder", "lineOrder", b"\0")
    head += entry("pixelAspectRatio", "float", struct.pack("<f", 1.0))
    head += entry("screenWindowCenter", "v2f", bytes(8)) + entry("screenWindowWidth", "float", struct.pack("<f", 1.0))
    head += b"\0"
    lines = []
    for row in range(height):
        chroma = [blue[row // 2], red[row // 2]] if row % 2 == 0 else []
        data = b"".join(one.astype("<f2").tobytes() for one in [*chroma, y[row]])
        lines.append(struct.pack("<ii", row, len(data)) + data)
    at = len(head) + 8 * height + np.cumsum([0, *(len(line) for line in lines[:-1])])
    path.write_bytes(head + at.astype("<u8").tobytes() + b"".join(lines))


def test_luminance_and_chroma_become_colours(tmp_path: Path) -> None:
    colour = np.array([0.6, 0.3, 0.2])
    y = float(colour @ LUMINANCE)
    chroma = [np.full((16, 32), (colour[k] - y) / y) for k in (0, 2)]
    luma_chroma(tmp_path / "plate.exr", np.full((32, 64), y), *chroma)
    with uw.open_video(tmp_path / "plate.exr") as video:
        got = next(video.frames()).image_linear
    np.testing.assert_allclose(got, np.broadcast_to(colour, got.shape), rtol=tol.HALF)


HDR_LINES = (b"EXPOSURE=2.0", b"EXPOSURE=4.0", b"PRIMARIES=0.68 0.32 0.265 0.69 0.15 0.06 0.3127 0.329")
TURNS: dict[bytes, Callable[[Any], Any]] = {
    b"-Y %d +X %d": lambda v: v, b"+Y %d +X %d": lambda v: v[::-1], b"-Y %d -X %d": lambda v: v[:, ::-1],
    b"+X %d -Y %d": lambda v: v.swapaxes(0, 1), b"-X %d +Y %d": lambda v: v[::-1, ::-1].swapaxes(0, 1),
}  # fmt: skip


@pytest.mark.parametrize("size", TURNS)
def test_radiance_pictures_are_read_by_their_header_and_keep_it(size: bytes, tmp_path: Path) -> None:
    upright = light()
    stored = np.ascontiguousarray(TURNS[size](upright))
    data = cv2.imencode(".hdr", stored[..., ::-1])[1].tobytes()
    pixels = data[data.index(b"+X %d\n" % stored.shape[1]) + len(b"+X %d\n" % stored.shape[1]) :]
    head = b"#?RADIANCE\n" + b"\n".join(HDR_LINES) + b"\nFORMAT=32-bit_rle_rgbe\n\n"
    (tmp_path / "plate.hdr").write_bytes(head + size % stored.shape[:2] + b"\n" + pixels)
    with uw.open_video(tmp_path / "plate.hdr") as video:
        got = next(video.frames()).image_linear
        assert any("an exposure of 8" in note for note in video.notes)
    expected = upright @ rec709_from_chromaticities(np.reshape(P3, (4, 2))).T / 8.0
    np.testing.assert_allclose(got, expected, atol=tol.RGBE)
    uw.video.transcode(tmp_path / "plate.hdr", tmp_path / "out.hdr")
    assert all(line in (tmp_path / "out.hdr").read_bytes() for line in HDR_LINES)
    np.testing.assert_array_equal(read_picture(tmp_path / "out.hdr"), read_picture(tmp_path / "plate.hdr"))


def test_radiance_pictures_of_photoshop_name_no_primaries(tmp_path: Path) -> None:
    """It writes zeros for what it does not know, as in maps of Poly Haven: they count as Rec. 709."""
    data = cv2.imencode(".hdr", np.ascontiguousarray(light()[..., ::-1]))[1].tobytes()
    zeros = b"#?RADIANCE\nGAMMA=1\nPRIMARIES=0 0 0 0 0 0 0 0\n"
    (tmp_path / "plate.hdr").write_bytes(data.replace(b"#?RADIANCE\n", zeros, 1))
    with uw.open_video(tmp_path / "plate.hdr") as video:
        np.testing.assert_allclose(next(video.frames()).image_linear, light(), atol=tol.RGBE)


def test_radiance_pictures_in_xyz(tmp_path: Path) -> None:
    data = cv2.imencode(".hdr", np.full((32, 64, 3), 0.5, np.float32))[1].tobytes()
    (tmp_path / "plate.hdr").write_bytes(data.replace(b"rle_rgbe", b"rle_xyze"))
    with uw.open_video(tmp_path / "plate.hdr") as video:
        np.testing.assert_allclose(next(video.frames()).image_linear, 0.5, rtol=1e-6)  # equal energy is white


def matte_files(folder: Path) -> dict[str, Path]:
    """Return mattes, half black and half white, in all forms."""
    matte = np.zeros((32, 64), np.uint8)
    matte[:, 32:] = 255
    black, files = np.zeros_like(matte), {}

    def png_of(name: str, picture: Image.Image, **options: Any) -> None:
        files[name] = folder / f"{name}.png"
        picture.save(files[name], **options)

    png_of("rgba", Image.fromarray(np.dstack([black, black, black, matte])))
    png_of("la", Image.fromarray(np.dstack([black, matte]), "LA"))
    png_of("bit", Image.fromarray(matte).convert("1"))
    png_of("palette", Image.fromarray(np.where(matte, 1, 0).astype(np.uint8), "P"), transparency=bytes([0, 255]))
    png_of("grey", Image.fromarray(matte))
    png_of("opaque", Image.fromarray(np.dstack([matte, matte, matte, np.full_like(matte, 255)])))
    files["16 bits"] = folder / "deep.png"
    cv2.imwrite(str(files["16 bits"]), np.dstack([black, black, black, matte]).astype(np.uint16) * 257)
    for name, channels in {
        "exr a": {"A": matte / np.float32(255)},
        "exr half": {"RGBA": (np.dstack([black, black, black, matte]) / 255).astype(np.float16)},
    }.items():
        files[name] = folder / f"{name}.exr"
        write_exr(files[name], {"": {key: value.astype(np.float16) for key, value in channels.items()}})
    return files


def test_mattes_are_read_by_their_alpha_in_every_form(tmp_path: Path, subtests: pytest.Subtests) -> None:
    for name, path in matte_files(tmp_path).items():
        with subtests.test(name), uw.open_video(path, transfer="linear", equirectangular=False, matte=True) as video:
            got = next(video.frames()).image_linear
            np.testing.assert_array_equal(got[:, :32], 0.0)
            np.testing.assert_array_equal(got[:, 32:], 1.0)
            assert video.notes == ()


def test_alpha_is_the_matte_where_colours_say_something_else(tmp_path: Path) -> None:
    matte = np.zeros((32, 64), np.uint8)
    matte[:, 32:] = 255
    Image.fromarray(np.dstack([matte[:, ::-1]] * 3 + [matte])).save(tmp_path / "both.png")
    with uw.open_video(tmp_path / "both.png", transfer="linear", equirectangular=False, matte=True) as video:
        np.testing.assert_array_equal(next(video.frames()).image_linear[..., 0] * 255, matte)
        assert any("the alpha is the matte" in note for note in video.notes)


def test_numbers_of_a_sequence_are_kept(tmp_path: Path) -> None:
    for number in (1001, 1002, 1003):
        cv2.imwrite(str(tmp_path / f"plate.{number}.png"), np.full((32, 64, 3), number - 1000, np.uint8))
    for pattern in ("plate.%04d.png", "plate.%d.png", "plate.####.png", "plate.@@@@.png"):
        with uw.open_video(tmp_path / pattern) as video:
            assert video.first_number == 1001
            assert video.numbered_range(1002, 1004) == (1, 3)
            assert video.numbered_range() == (0, 3)
            with pytest.raises(VideoError, match="numbered 1001 to 1003"):
                video.numbered_range(1, 3)
    uw.video.transcode(tmp_path / "plate.%04d.png", tmp_path / "out.%04d.png", start=1)
    assert sorted(file.name for file in tmp_path.glob("out*")) == ["out.1002.png", "out.1003.png"]
    with uw.open_video(tmp_path / "plate.1002.png") as video:
        assert any("is one of a sequence" in note and "plate.####.png" in note for note in video.notes)


def by_ffmpeg(codec: str, layout: str, codes: NDArray[np.uint16]) -> bytes:
    """Return a picture of a codec of FFmpeg with planes of green, blue and red."""
    import av

    context = av.CodecContext.create(codec, "w")
    context.height, context.width = codes.shape[:2]
    context.pix_fmt, context.time_base = layout, Fraction(1)
    frame = av.VideoFrame(context.width, context.height, layout)
    for plane, channel in zip(frame.planes, (1, 2, 0), strict=True):
        rows = np.zeros((plane.height, plane.line_size // 2), np.uint16)
        rows[:, : plane.width] = codes[..., channel]
        plane.update(rows.tobytes())
    return b"".join(bytes(packet) for packet in [*context.encode(frame), *context.encode(None)])


def encoded(kind: str, codes: NDArray[np.uint8]) -> bytes:
    if kind == ".dpx":
        return by_ffmpeg("dpx", "gbrp10le", np.rint(codes * (1023 / 255)).astype(np.uint16))
    if kind in (".tga", ".avif"):
        out = io.BytesIO()
        Image.fromarray(codes).save(
            out, kind[1:].upper(), **({"quality": 100, "subsampling": "4:4:4"} if kind == ".avif" else {})
        )
        return out.getvalue()
    return cv2.imencode(kind, codes[..., ::-1])[1].tobytes()


@pytest.mark.parametrize("kind", [".dpx", ".tga", ".jp2", ".avif", ".bmp"])
def test_more_kinds_are_read(kind: str, tmp_path: Path) -> None:
    codes = np.rint(cv2.resize(light(), (256, 128)) * 255).astype(np.uint8)
    codes = codes if kind != ".dpx" else np.ascontiguousarray(codes[:32, :64])
    for number in (7, 8):
        (tmp_path / f"p_{number:04d}{kind}").write_bytes(encoded(kind, codes))
    got = read_picture(tmp_path / f"p_0007{kind}")
    scale = np.iinfo(got.dtype).max
    assert np.abs(got / scale - codes / 255.0).max() < (tol.LOSSY if kind in (".avif", ".jp2") else 2.0 / 255.0)
    with uw.open_video(tmp_path / f"p_%04d{kind}") as video:
        assert video.frame_count == 2


@pytest.mark.parametrize(
    ("kind", "layout", "bits"), [(".jp2", "gbrp12le", 12), (".dpx", "gbrp12le", 12), (".avif", "", 10)]
)
def test_ten_and_twelve_bits_are_whole(kind: str, layout: str, bits: int, tmp_path: Path) -> None:
    """White is full scale, whatever the number of bits."""
    white = np.full((128, 256, 3), (1 << bits) - 1, np.uint16)
    if layout:
        data = by_ffmpeg({".jp2": "jpeg2000", ".dpx": "dpx"}[kind], layout, white)
    else:
        data = cv2.imencode(kind, white, [cv2.IMWRITE_AVIF_DEPTH, bits, cv2.IMWRITE_AVIF_QUALITY, 100])[1].tobytes()
    (tmp_path / f"p{kind}").write_bytes(data)
    got = read_picture(tmp_path / f"p{kind}")
    assert got.dtype == np.uint16
    assert got.min() >= 65535 * (1 - 2**-9)


def test_kinds_that_are_not_read_are_explained(tmp_path: Path) -> None:
    for name, data, says in (
        ("shot.dng", b"II*\0" + bytes(100), "camera raw"),
        ("shot.heic", b"\0\0\0\x18ftypheic" + bytes(100), "HEIC"),
        ("shot.tga", b"This is no picture", "not a picture"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(VideoError, match=says):
            uw.open_video(tmp_path / name)
    cv2.imwrite(str(tmp_path / "a.jpg"), np.zeros((32, 64, 3), np.uint8))
    (tmp_path / "a.jpg").rename(tmp_path / "IMG_1.insp")
    with pytest.raises(VideoError, match=r"dual_fisheye.*ffmpeg -i IMG_1\.insp"):
        uw.open_video(tmp_path / "IMG_1.insp")
    with pytest.raises(VideoError, match="is not written"):
        uw.video.create_video(tmp_path / "out.dpx", width=64, height=32)


@pytest.mark.parametrize(("name", "columns"), [("wide.webp", 16400), ("wide.jpg", 65600)])
def test_a_picture_that_its_format_does_not_hold_is_refused(name: str, columns: int, tmp_path: Path) -> None:
    frame = VideoFrame.of_linear(np.zeros((2, columns, 3), np.float32))
    with pytest.raises(VideoError, match=f"are not so large .got {columns}x2"):
        write_picture(tmp_path / name, frame)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["out.dpx", "out.tga", "out.jp2"])
def test_stills_of_kinds_that_are_only_read_are_refused(name: str, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "plate.png"), np.zeros((32, 64, 3), np.uint8))
    with pytest.raises(ParameterError, match="no name of a picture that is written"):
        save_still(tmp_path / name, uw.Scene(plate=tmp_path / "plate.png"))


@pytest.mark.parametrize(
    "broken",
    [(b"cICP", b""), (b"cICP", b"\1"), profiled(icc(ADOBE, gamma(0.0))), (b"gAMA", b"\0"), (b"cHRM", bytes(32))],
)
def test_colours_that_are_broken_are_left_out_and_said(broken: tuple[bytes, bytes], tmp_path: Path) -> None:
    codes = np.full((32, 64, 3), 90, np.uint8)
    (tmp_path / "plate.png").write_bytes(png(codes, broken))
    with uw.open_video(tmp_path / "plate.png") as video:
        np.testing.assert_array_equal(next(video.frames()).rgb, codes)
        assert any("cannot be used" in note for note in video.notes)


@pytest.mark.parametrize("wide", ["nan", "inf", "1e400"])
def test_a_place_in_a_panorama_that_is_no_number_counts_as_none(wide: str, tmp_path: Path) -> None:
    mark = xmp(64, 32).replace(b'FullPanoWidthPixels="64"', f'FullPanoWidthPixels="{wide}"'.encode())
    (tmp_path / "plate.png").write_bytes(with_tags(png(np.full((32, 64, 3), 90, np.uint8)), ".png", b"", b"", mark))
    with uw.open_video(tmp_path / "plate.png") as video:
        assert next(video.frames()).shape == (32, 64)
