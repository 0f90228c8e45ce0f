# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import OpenEXR
import pytest

from mr360uw.errors import VideoError
from mr360uw.video import read_exr, read_rgb, write_exr


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
    write_exr(tmp_path / "a.exr", image, full_size=(64, 32), origin=(10, 20), attributes={"frame": 7, "water": "IB"})
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        header = file.header()
        assert header["envmap"] == OpenEXR.ENVMAP_LATLONG
        np.testing.assert_array_equal(header["dataWindow"], [(10, 20), (17, 25)])
        np.testing.assert_array_equal(header["displayWindow"], [(0, 0), (63, 31)])
        assert (header["frame"], header["water"]) == (7, "IB")
    write_exr(tmp_path / "b.exr", image, latlong=False, compression="none")
    with OpenEXR.File(str(tmp_path / "b.exr")) as file:
        assert "envmap" not in file.header()


def test_maps_of_others(shared) -> None:
    folder = shared / "data/footage/hdr"
    assert read_rgb(folder / "blender_city_dwab.exr").min() < 0  # as stored; a lossy codec did it
    chart = read_rgb(folder / "OrientationLatLong.exr")
    assert chart.shape == (512, 1024, 3)
    assert read_rgb(folder / "KernerEnvLatLong.exr").max() > 1000


def test_bad_files(tmp_path) -> None:
    (tmp_path / "text.exr").write_text("no picture")
    with pytest.raises(VideoError, match="not an EXR file"):
        read_exr(tmp_path / "text.exr")
    write_exr(tmp_path / "depth.exr", {"": {"Z": np.ones((4, 8), np.float32)}})
    with pytest.raises(VideoError, match=r"no colour channels R, G, B .got Z"):
        read_rgb(tmp_path / "depth.exr")
    write_exr(tmp_path / "grey.exr", {"": {"Y": np.full((4, 8), 2.0, np.float32)}})
    assert read_rgb(tmp_path / "grey.exr")[0, 0].tolist() == [2.0, 2.0, 2.0]
    with pytest.raises(VideoError, match="cannot be written"):
        write_exr(tmp_path / "missing" / "a.exr", np.ones((4, 8, 3), np.float32))
