# SPDX-License-Identifier: Apache-2.0
"""Plates of BT.2020: the light they give is the light the composite works in."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import mr360uw.ibl as ibl
from mr360uw.base.color import Matrix, encode, rec709_from_plate, ycbcr_from_rgb
from mr360uw.base.sphere import directions, unit
from mr360uw.ibl.settings import LightSettings
from mr360uw.types import Layer, Tile, YuvImage
from mr360uw.video.reader import VideoFrame
from tests.ibl.plates import angle_deg, clipped, planes, sky
from tests.ibl.tolerances import (
    PRIMARIES_CODE,
    PRIMARIES_LIGHT,
    PRIMARIES_STANDARD,
    PRIMARIES_SUN,
    SUN_HDR_DEG,
    YUV_MEAN,
)

TOWARDS = unit([0.3, 0.7, 0.2])


def coloured() -> np.ndarray:
    """Return a clipped plate (512, 1024, 3) with a blue-green sky, a red floor and a sun."""
    floor = directions(1024, 512)[..., 1:2] < 0.0
    return clipped(sky(TOWARDS, width=1024) * np.where(floor, [1.0, 0.35, 0.2], [0.45, 0.9, 1.0]))


def full_chroma(yuv: YuvImage) -> YuvImage:
    """Return a 4:2:0 frame as 4:4:4, which is decoded in full."""
    u, v = (np.repeat(np.repeat(plane, 2, 0), 2, 1) for plane in (yuv.u, yuv.v))
    return YuvImage(yuv.y, u, v, yuv.spec)


def test_the_matrix_is_the_published_one() -> None:
    published = [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]]  # ITU-R BT.2087-0, M2
    np.testing.assert_allclose(np.linalg.inv(rec709_from_plate("bt2020")), published, atol=PRIMARIES_STANDARD)
    np.testing.assert_allclose(
        ycbcr_from_rgb("bt709")[0] @ rec709_from_plate("bt2020"), ycbcr_from_rgb("bt2020")[0], atol=PRIMARIES_STANDARD
    )  # both are luminance


@pytest.mark.parametrize(
    ("operator", "full"),
    [("none", False), ("closure", False), ("closure", True), ("mr360", False), ("kovaleski", False)],
)
def test_the_same_scene_gives_the_same_light(operator: str, full: bool) -> None:
    chosen = LightSettings(operator=operator)
    lights = []
    for matrix in ("bt709", "bt2020"):
        yuv = planes(coloured(), 10, matrix)
        lights.append(ibl.environment_from_yuv(full_chroma(yuv) if full else yuv, chosen))
    one, other = lights
    assert one.sun is not None
    assert other.sun is not None
    assert angle_deg(one.sun.direction, other.sun.direction) < SUN_HDR_DEG
    np.testing.assert_allclose(other.sun.irradiance, one.sun.irradiance, rtol=PRIMARIES_SUN)
    for name in ("irradiance", "ambient", "residual"):
        a, b = getattr(one, name), getattr(other, name)
        assert np.all(np.abs(a - b).mean(axis=(0, 1)) < PRIMARIES_LIGHT * a.mean(axis=(0, 1))), name


@pytest.mark.parametrize("matrix", ["bt709", "bt2020"])
@pytest.mark.parametrize("colour", [(0.05, 0.5, 0.6), (0.7, 0.2, 0.1), (0.4, 0.4, 0.4)])
def test_a_white_body_vanishes_in_light_from_all_sides(matrix: Matrix, colour: tuple[float, ...]) -> None:
    """Its radiance is the irradiance over pi; laid over the plate it has the codes that are there already."""
    plate = np.full((64, 128, 3), colour, np.float32)
    yuv = planes(plate, 10, matrix)
    light = ibl.environment_from_yuv(yuv, sun=None)
    np.testing.assert_allclose(light.residual[16, 32], colour, atol=YUV_MEAN * max(colour))
    radiance = np.full((64, 128, 3), light.ambient[16, 32] / np.pi, np.float32)
    ones = np.ones((64, 128), np.float32)
    tile = Tile(0, 0, radiance, ones, ones, np.ones((64, 128, 3), np.float32), np.zeros((64, 128, 3), np.float32))
    frame = VideoFrame(0, 0, Fraction(1, 25), 0.0, 1, yuv.spec, yuv=yuv)
    got = frame.over(Layer(64, 128, (tile,))).yuv
    assert got is not None
    for new, old in ((got.y, yuv.y), (got.u, yuv.u), (got.v, yuv.v)):
        assert np.abs(new.astype(int) - old.astype(int)).max() <= PRIMARIES_CODE


def test_colours_beside_the_gamut_give_no_negative_light() -> None:
    """A green of BT.2020 is less than no red in Rec.709; a surface cannot be lit by that."""
    ycc = encode(np.array([0.02, 0.6, 0.1]), "srgb") @ ycbcr_from_rgb("bt2020").T
    yuv = planes(np.zeros((64, 128, 3)), 10, "bt2020")
    for plane, code in zip(
        (yuv.y, yuv.u, yuv.v), (64 + 876 * ycc[0], 512 + 896 * ycc[1], 512 + 896 * ycc[2]), strict=True
    ):
        plane[:] = round(code)
    for image in (yuv, full_chroma(yuv)):
        light = ibl.environment_from_yuv(image, glossy=True)
        for map_ in (light.radiance, light.residual, light.ambient, light.irradiance, light.glossy):
            assert map_.min() >= 0.0
        assert light.residual[..., 0].max() == 0.0
