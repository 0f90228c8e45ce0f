# SPDX-License-Identifier: Apache-2.0
"""ICC profiles of tables keep all bits of pictures of 16 bits, in each of the kinds of tables that the standard has."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import mr360uw as uw
from tests.video import tolerances as tol
from tests.video.test_picture_files import ADOBE, REC709_FROM_D50, png, profiled

Floats = NDArray[np.float64]
GRID, GAMMA = 17, 2.0
RISING = np.linspace(0.0, 1.0, 4096)
D50 = np.array([0.9642, 1.0, 0.8249])


def lab(xyz: Floats) -> Floats:
    """Return L*, a*, b* of XYZ (CIE 15, 8.2.1)."""
    t = xyz / D50
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t * (29 / 6) ** 2 / 3 + 4 / 29)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=-1)


def nodes(curved: bool) -> Floats:
    """Return XYZ of the nodes of a table of Adobe RGB's primaries, red slowest; curved: of codes, else of light."""
    axis = np.linspace(0.0, 1.0, GRID)
    rgb = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray((rgb**GAMMA if curved else rgb) @ ADOBE.T)


def shorts(values: Floats) -> bytes:
    return np.rint(np.clip(values, 0.0, 1.0) * 65535).astype(">u2").tobytes()


def lut16(curved: bool, pcs: bytes) -> bytes:
    """Return a tag of kind lut16: the curves of codes stand before the table, or in it."""
    xyz = nodes(curved)
    codes = xyz / (1 + 32767 / 32768)
    if pcs == b"Lab ":
        codes = (lab(xyz) / [100, 1, 1] * [65280, 256, 256] + [0, 32768, 32768]) / 65535
    first = shorts(np.tile(RISING if curved else RISING**GAMMA, 3))
    head = b"mft2" + bytes(4) + bytes([3, 3, GRID, 0]) + bytes(36) + struct.pack(">2H", len(RISING), 2)
    return head + first + shorts(codes) + shorts(np.tile([0.0, 1.0], 3))


def packed(curved: bool, pcs: bytes) -> bytes:
    """Return a tag of kind lutAToB: curves, table, and the curves behind it."""
    del curved
    codes = nodes(False) / (1 + 32767 / 32768)
    if pcs == b"Lab ":
        codes = (lab(nodes(False)) / [100, 1, 1] + [0, 128, 128]) / [1, 255, 255]
    curve = b"para" + bytes(4) + struct.pack(">HHi", 0, 0, round(GAMMA * 65536))
    plain = b"curv" + bytes(8)
    cube = bytes([GRID] * 3) + bytes(13) + bytes([2, 0, 0, 0]) + shorts(codes)
    cube += bytes(-len(cube) % 4)
    b = 32
    at_cube, at_a = b + 36, b + 36 + len(cube)
    return (
        b"mAB "
        + bytes(4)
        + bytes([3, 3, 0, 0])
        + struct.pack(">5I", b, 0, 0, at_cube, at_a)
        + plain * 3
        + cube
        + curve * 3
    )


def profile(tag: bytes, pcs: bytes) -> bytes:
    """Return a profile whose one tag is a table."""
    head = struct.pack(">I4s4s4s4s4s", 144 + len(tag), bytes(4), b"\x04\x00\0\0", b"scnr", b"RGB ", pcs)
    head = (head.ljust(36, b"\0") + b"acsp").ljust(128, b"\0")
    head = head[:68] + struct.pack(">3i", 63190, 65536, 54061) + head[80:]
    return head + struct.pack(">I4sII", 1, b"A2B0", 144, len(tag)) + tag


@pytest.mark.parametrize("kind", [lut16, packed])
def test_tables_are_read_in_floats(kind: Callable[[bool, bytes], bytes], tmp_path: Path) -> None:
    """Of light that is linear between the nodes the table is exact: what differs is its 16 bits."""
    grey = np.linspace(9000, 50000, 128 * 64).reshape(64, 128, 1)
    codes = (grey * [1.0, 0.9, 0.8]).astype(np.uint16)
    (tmp_path / "plate.png").write_bytes(png(codes, profiled(profile(kind(False, b"XYZ "), b"XYZ "))))
    with uw.open_video(tmp_path / "plate.png") as video:
        found = next(video.frames()).image_linear
    expected = (codes / 65535.0) ** GAMMA @ (REC709_FROM_D50 @ ADOBE).T
    np.testing.assert_allclose(found, expected, atol=tol.PROFILE)
    # All 16 bits count: neighbouring codes have light of their own
    assert len(np.unique(found[..., 1])) > 0.99 * len(np.unique(codes[..., 1]))


@pytest.mark.parametrize(("kind", "power"), [(lut16, 1.0), (packed, 1.0 / GAMMA)])
def test_tables_may_be_of_lightness(kind: Callable[[bool, bytes], bytes], power: float, tmp_path: Path) -> None:
    """At the nodes of a table of L*a*b* the light is that of the profile; between them lightness runs straight.

    Near white the digits of the published matrix make a difference of 4e-4.
    """
    values = np.rint(np.linspace(0.0, 1.0, GRID) ** power * 65535).astype(np.uint16)
    codes = np.resize(np.repeat(values[2:], 9), (64, 128, 1)) * np.ones(3, np.uint16)
    (tmp_path / "plate.png").write_bytes(png(codes, profiled(profile(kind(True, b"Lab "), b"Lab "))))
    with uw.open_video(tmp_path / "plate.png") as video:
        found = next(video.frames()).image_linear
    expected = (codes / 65535.0) ** GAMMA @ (REC709_FROM_D50 @ ADOBE).T
    np.testing.assert_allclose(found, expected, atol=tol.PROFILE, rtol=5e-4)


def test_untouched_codes_come_back(tmp_path: Path) -> None:
    """A copy of a picture with a table has the same codes, to a few of 16 bits: the map is inverted."""
    codes = (np.linspace(9000, 50000, 128 * 64).reshape(64, 128, 1) * [1.0, 0.9, 0.8]).astype(np.uint16)
    (tmp_path / "plate.png").write_bytes(png(codes, profiled(profile(lut16(False, b"Lab "), b"Lab "))))
    uw.video.transcode(tmp_path / "plate.png", tmp_path / "copy.png")
    assert np.array_equal(uw.video.read_picture(tmp_path / "copy.png"), codes)


def test_broken_tables_are_said(tmp_path: Path) -> None:
    codes = np.full((64, 128, 3), 120, np.uint8)
    for name, tag in (("cut", lut16(False, b"XYZ ")[:500]), ("other", b"mpet" + bytes(60))):
        (tmp_path / f"{name}.png").write_bytes(png(codes, profiled(profile(tag, b"XYZ "))))
        with uw.open_video(tmp_path / f"{name}.png") as video:
            assert any("cannot be used" in note and "read as sRGB" in note for note in video.notes)
