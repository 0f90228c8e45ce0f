# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from mr360uw.errors import VideoError
from mr360uw.video import read_exr, read_picture, write_exr
from mr360uw.video.other_tracks import frame_attributes, later_timecode
from tests.video.clips import exr_windows


def test_parts_channels_and_kinds_come_back(tmp_path, rng) -> None:
    beauty = rng.uniform(-1, 100, (10, 20, 4)).astype(np.float16)
    depth = rng.uniform(0, 1e4, (10, 20)).astype(np.float32)
    normal = rng.uniform(-1, 1, (10, 20, 3)).astype(np.float16)
    ids = rng.integers(0, 1 << 32, (10, 20), np.uint32)
    parts = {"beauty": {"RGBA": beauty}, "data": {"Z": depth, "normal": normal, "id": ids}}
    write_exr(tmp_path / "a.exr", parts)
    again = read_exr(tmp_path / "a.exr")
    assert list(again) == ["beauty", "data"]
    np.testing.assert_array_equal(again["beauty"]["RGBA"], beauty)
    for name, expected in (("Z", depth), ("normal", normal), ("id", ids)):
        np.testing.assert_array_equal(again["data"][name], expected)
        assert again["data"][name].dtype == expected.dtype
    assert set(parts["data"]) == {"Z", "normal", "id"}  # the arguments are left alone
    assert parts["data"]["Z"] is depth
    assert list(tmp_path.iterdir()) == [tmp_path / "a.exr"]


def test_header(tmp_path) -> None:
    image = np.ones((6, 8, 3), np.float32)
    windows = exr_windows((10, 20), (8, 6), frame=(64, 32))
    write_exr(tmp_path / "a.exr", image, attributes={"frame": 7, "water": "IB", **windows})
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        header = file.header()
        assert header["envmap"] == OpenEXR.ENVMAP_LATLONG
        np.testing.assert_array_equal(header["dataWindow"], [(10, 20), (17, 25)])
        np.testing.assert_array_equal(header["displayWindow"], [(0, 0), (63, 31)])
        assert (header["frame"], header["water"]) == (7, "IB")
    write_exr(tmp_path / "b.exr", image, latlong=False)
    with OpenEXR.File(str(tmp_path / "b.exr")) as file:
        assert "envmap" not in file.header()


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("compression", [OpenEXR.ZIP_COMPRESSION, OpenEXR.PIZ_COMPRESSION, OpenEXR.RLE_COMPRESSION])
def test_maps_of_others(tmp_path, rng, dtype, compression) -> None:
    """Values as stored, those below zero too, which lossy codecs make; more channels than colour."""
    image = rng.lognormal(0.0, 3.0, (32, 64, 3)).clip(0.0, 6e4).astype(dtype)
    image[3, 4] = -0.01
    channels = {"R": image[..., 0], "G": image[..., 1], "B": image[..., 2], "A": np.ones((32, 64), dtype)}
    header = {"compression": compression, "type": OpenEXR.scanlineimage, "envmap": OpenEXR.ENVMAP_LATLONG}
    with OpenEXR.File(header, {name: np.ascontiguousarray(data) for name, data in channels.items()}) as file:
        file.write(str(tmp_path / "map.exr"))
    np.testing.assert_array_equal(read_picture(tmp_path / "map.exr"), image.astype(np.float32))


def test_tiled_maps_of_others(tmp_path, rng) -> None:
    image = rng.uniform(0.0, 2000.0, (50, 100, 3)).astype(np.float16)
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.tiledimage,
        "tiles": OpenEXR.TileDescription(),
    }
    with OpenEXR.File(header, {"RGB": image}) as file:
        file.write(str(tmp_path / "tiles.exr"))
    np.testing.assert_array_equal(read_picture(tmp_path / "tiles.exr"), image.astype(np.float32))


def test_bad_files(tmp_path) -> None:
    (tmp_path / "text.exr").write_text("no picture")
    with pytest.raises(VideoError, match="not an EXR file"):
        read_exr(tmp_path / "text.exr")
    write_exr(tmp_path / "depth.exr", {"": {"Z": np.ones((4, 8), np.float32)}})
    with pytest.raises(VideoError, match=r"no colour channels R, G, B .got Z"):
        read_picture(tmp_path / "depth.exr")
    write_exr(tmp_path / "grey.exr", {"": {"Y": np.full((4, 8), 2.0, np.float32)}})
    assert read_picture(tmp_path / "grey.exr")[0, 0].tolist() == [2.0, 2.0, 2.0]
    with pytest.raises(VideoError, match="cannot be written"):
        write_exr(tmp_path / "missing" / "a.exr", np.ones((4, 8, 3), np.float32))


@pytest.mark.parametrize(("rate", "told", "expected"), [
    (Fraction(25), "", (0, 0, 2, 3)), (Fraction(30000, 1001), "10:00:00;00", (10, 0, 1, 23)), (Fraction(120), "", None),
])  # fmt: skip
def test_the_header_says_which_frame_it_is(
    tmp_path: Path, rate: Fraction, told: str, expected: tuple[int, int, int, int] | None
) -> None:
    timecode = later_timecode(told, 53, rate)
    write_exr(tmp_path / "a.exr", np.ones((2, 4, 3), np.float32), attributes=frame_attributes(53, rate, timecode))
    header = OpenEXR.File(str(tmp_path / "a.exr")).header()
    assert header["frameNumber"] == 53
    assert header["framesPerSecond"] == rate
    code = header.get("timeCode")
    assert (code and (code.hours, code.minutes, code.seconds, code.frame)) == expected
    assert code is None or code.dropFrame == (";" in told)
