# SPDX-License-Identifier: Apache-2.0
"""Pictures and videos that are damaged, no pictures, or larger than any memory."""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from mr360uw.base.input_files import picture_size
from mr360uw.errors import VideoError
from mr360uw.video import open_video, read_picture, write_exr
from tests.hostile.bench import Bench
from tests.video.clips import write_clip

KINDS = (".png", ".jpg", ".tif", ".bmp", ".webp", ".hdr", ".exr")


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_of(width: int, height: int, depth: int = 8, color: int = 2) -> bytes:
    """Return a PNG that announces a size and holds some rows of zeros."""
    head = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)
    rows = zlib.compress(bytes(100_000), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def announced(data: bytes, suffix: str, width: int, height: int) -> bytes:
    """Return a good picture whose header announces another size."""
    if suffix == ".png":
        return png_of(width, height)
    if suffix == ".hdr":
        return data.replace(b"-Y 32 +X 64", f"-Y {height} +X {width}".encode())
    changed = bytearray(data)
    if suffix == ".bmp":
        struct.pack_into("<ii", changed, 18, width, height)
    elif suffix == ".jpg":
        at = data.index(b"\xff\xc0")
        struct.pack_into(">HH", changed, at + 5, min(height, 65500), min(width, 65500))
    elif suffix == ".exr":
        at = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
        struct.pack_into("<4i", changed, at, 0, 0, width - 1, height - 1)
    elif suffix == ".tif":
        directory = struct.unpack_from("<I", data, 4)[0]
        for entry in range(struct.unpack_from("<H", data, directory)[0]):
            place = directory + 2 + 12 * entry
            tag = struct.unpack_from("<H", data, place)[0]
            if tag in (256, 257):
                struct.pack_into("<HHII", changed, place, tag, 4, 1, width if tag == 256 else height)
    else:
        at = data.index(b"VP8")
        if data[at : at + 4] == b"VP8L":
            struct.pack_into("<I", changed, at + 9, 0x0FFFFFFF)
        else:
            struct.pack_into("<HH", changed, at + 14, 0x3FFF, 0x3FFF)
    return bytes(changed)


def test_the_size_of_a_picture_is_read_from_its_head(bench: Bench, subtests: pytest.Subtests) -> None:
    for suffix in KINDS[:-1]:
        with subtests.test(suffix):
            data = bench.material.files[f"plate{suffix}"]
            assert picture_size(data) == (64, 32)
            for length in range(0, 64, 3):
                assert picture_size(data[:length]) in (None, (64, 32))


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda _: b"",
    "one byte": lambda data: data[:1],
    "head alone": lambda data: data[:40],
    "half": lambda data: data[: len(data) // 2],
    "nearly whole": lambda data: data[:-40],
    "zeros": lambda data: bytes(len(data)),
    "zeros after its head": lambda data: data[:60] + bytes(len(data) - 60),
    "text": lambda _: b"This is no picture.\n" * 100,
    "page": lambda _: b"<!DOCTYPE html><html><body>404 Not Found</body></html>" * 20,
}


BLACK = (".bmp", "zeros after its head")
"""A whole picture, for it is not compressed."""


def test_damaged_plates(bench: Bench, subtests: pytest.Subtests) -> None:
    for suffix, damage in [pair for pair in itertools.product(KINDS, DAMAGE) if pair != BLACK]:
        with subtests.test(suffix=suffix, damage=damage):
            name = f"broken{suffix}"
            bench.put(name, DAMAGE[damage](bench.material.files[f"plate{suffix}"]))
            bench.refuses_with(f'plate.path="{name}"', says=(name,))


def test_pictures_that_announce_more_than_memory_holds(bench: Bench, subtests: pytest.Subtests) -> None:
    for suffix in KINDS:
        with subtests.test(suffix):
            name = f"bomb{suffix}"
            bench.put(name, announced(bench.material.files[f"plate{suffix}"], suffix, 100_000, 50_000))
            bench.refuses_with(f'plate.path="{name}"', says=(name, "set MR360UW_MAX_PICTURE to allow more"))


ROLES = {
    "texture": ('object.0.texture="{}"', (".png", ".jpg", ".webp")),
    "heights": ('receiver={{kind="height_map", path="{}"}}', (".png", ".tif")),
    "distances": ('receiver={{kind="distance", path="{}"}}', (".png", ".exr")),
    "matte": ('holdout=[{{path="{}"}}]', (".png", ".exr")),
}


def test_pictures_in_other_roles(bench: Bench, subtests: pytest.Subtests) -> None:
    for role, (setting, kinds) in ROLES.items():
        for suffix, damage in itertools.product(kinds, ["half", "text", "bomb", "zeros after its head"]):
            data, name = bench.material.files[f"plate{suffix}"], f"broken{suffix}"
            bomb = damage == "bomb"
            bench.put(name, announced(data, suffix, 100_000, 50_000) if bomb else DAMAGE[damage](data))
            with subtests.test(role, suffix=suffix, damage=damage):
                bench.refuses_with(setting.format(name), says=(name, *(["MR360UW_MAX_"] if bomb else [])))


SHAPES = {
    "square": (64, 64, "stereo"), "wide": (64, 20, "2:1"), "line": (64, 1, "2:1"), "pixel": (1, 1, ""),
    "odd": (63, 31, "2:1"),
}  # fmt: skip


def test_plates_of_other_shapes(bench: Bench, subtests: pytest.Subtests) -> None:
    for name, (width, height, says) in SHAPES.items():
        with subtests.test(name):
            cv2.imwrite(str(bench.folder / "shape.png"), np.zeros((height, width, 3), np.uint8))
            bench.refuses_with('plate.path="shape.png"', says=("shape.png", says))


def test_sequences_with_a_picture_missing_damaged_or_of_another_size(bench: Bench) -> None:
    good = bench.material.files["plate.png"]
    for number in (0, 1, 3):
        bench.put(f"s_{number}.png", good)
    setting = 'plate.path="s_%d.png"'
    bench.refuses_with(setting, says=("picture 2 of the sequence is missing",), out="out_%d.png")
    other = cv2.imencode(".png", np.zeros((16, 32, 3), np.uint8))[1].tobytes()
    for bad, data, says in ((2, good[:200], "cut short"), (3, other, "differs from the first")):
        bench.put("s_2.png", good)
        bench.put(f"s_{bad}.png", data)
        command = (
            "composite",
            "scene.toml",
            "out.png",
            "--set",
            setting,
            "--frames",
            str(bad),
            "--backend",
            "reference",
        )
        bench.refuses(*command, says=(f"s_{bad}.png", says))


def test_exr_pictures_without_colours_or_with_deep_or_odd_ones(bench: Bench) -> None:
    import OpenEXR

    path = bench.folder / "odd.exr"
    write_exr(path, {"": {"N.X": np.zeros((32, 64), np.float32)}})
    bench.refuses_with('plate.path="odd.exr"', says=("odd.exr", "no colour channels"))
    write_exr(path, np.full((32, 64, 3), np.nan, np.float32))
    bench.refuses_with('plate.path="odd.exr"', says=("odd.exr",))
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deepscanline}
    deep = np.empty((32, 64), object)
    for row in range(32):
        for column in range(64):
            deep[row, column] = np.zeros(2, np.float32)
    OpenEXR.File(header, {"Z": deep}).write(str(path))
    bench.refuses_with('plate.path="odd.exr"', says=("odd.exr", "deep samples"))


def test_pictures_of_kinds_that_are_not_read(bench: Bench) -> None:
    cv2.imwrite(str(bench.folder / "double.tif"), np.zeros((32, 64, 3)))
    with pytest.raises(VideoError, match="floats of 64 bits, which are not read"):
        read_picture(bench.folder / "double.tif")


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_clip(tmp_path_factory.mktemp("clip") / "clip.mp4", 3, size=(64, 32)).read_bytes()


CLIPS: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda _: b"",
    "half": lambda data: data[: len(data) // 2],
    "zeros": lambda data: bytes(len(data)),
    "head alone": lambda data: data[:32],
    "text": lambda _: b"This is no video.\n" * 100,
    "pictures of zeros": lambda data: zeroed(data, b"mdat"),
    "index of zeros": lambda data: zeroed(data, b"moov"),
    "box without end": lambda data: struct.pack(">I4sQ", 1, b"moov", 1 << 62) + data,
    "boxes within boxes": lambda data: nested(4000) + data,
    "size of zero": lambda data: struct.pack(">I4s", 0, b"free") + data,
    "wide": lambda data: sized(data, 65500, 32750),
    "flat": lambda data: sized(data, 0, 0),
}  # fmt: skip


def nested(depth: int) -> bytes:
    return b"".join(struct.pack(">I4s", 8 * (depth - k), b"moov") for k in range(depth))


def zeroed(data: bytes, kind: bytes) -> bytes:
    at = data.index(kind)
    size = struct.unpack_from(">I", data, at - 4)[0]
    return data[: at + 4] + bytes(size - 8) + data[at - 4 + size :]


def sized(data: bytes, width: int, height: int) -> bytes:
    """Return a clip whose sample entry and track header announce another size, and whose pictures are unreadable."""
    changed = bytearray(zeroed(data, b"mdat"))
    at = data.index(b"avc1", data.index(b"stsd"))
    struct.pack_into(">HH", changed, at + 28, width, height)
    return bytes(changed)


@pytest.mark.parametrize("role", ["plate.path", "holdout", "camera.gravity"])
def test_clips(role: str, clip: bytes, bench: Bench, subtests: pytest.Subtests) -> None:
    for name, damage in CLIPS.items():
        with subtests.test(name):
            bench.put("broken.mp4", damage(clip))
            setting = 'holdout=[{path="broken.mp4"}]' if role == "holdout" else f'{role}="broken.mp4"'
            bench.refuses_with(setting, says=("broken.mp4",))


def test_a_video_of_too_many_pixels_is_refused_before_it_is_decoded(
    bench: Bench, clip: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MR360UW_MAX_PICTURE", "0.001")
    bench.put("clip.mp4", clip)
    bench.refuses_with('plate.path="clip.mp4"', says=("clip.mp4 - is too large", "set MR360UW_MAX_PICTURE"))


def test_a_still_where_there_is_no_folder(tmp_path: Path) -> None:
    with pytest.raises(VideoError, match="no such file"):
        read_picture(tmp_path / "none" / "plate.png")


def test_heads_that_state_what_nobody_knows(tmp_path: Path, bench: Bench) -> None:
    tiff = bytearray(bench.material.files["plate.tif"])
    tiff_at = tiff.index(struct.pack("<HH", 262, 3))
    struct.pack_into("<HHI4s", tiff, tiff_at, 262, 2, 2, b"A\0\0\0")
    (tmp_path / "a.tif").write_bytes(tiff)
    with pytest.raises(VideoError, match="not a picture that can be read"):
        read_picture(tmp_path / "a.tif")

    write_exr(tmp_path / "a.exr", np.full((4, 8, 3), 0.5, np.float32))
    exr = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(exr.replace(b"\0chromaticities\0", b"\0chromaticitiez\0"))  # the type alone
    assert read_picture(tmp_path / "a.exr").shape == (4, 8, 3)

    film = write_clip(tmp_path / "a.mp4", frames=2)
    film.write_bytes(film.read_bytes().replace(b"avc1", b"zzzz"))
    with pytest.raises(VideoError, match="no video stream that can be decoded"):
        open_video(film)
