# SPDX-License-Identifier: Apache-2.0
"""The colour of a grade: both directions, and what patches tell of it."""

from __future__ import annotations

import itertools
from dataclasses import astuple, replace
from fractions import Fraction

import numpy as np
import pytest

from mr360uw.base.color import ColorSpec, decode, decode_signal, encode, in_plate_primaries, in_rec709
from mr360uw.composite.grading.colour_grade import MOST_LIGHT, NO_GRADE, ColourGrade, graded_spec
from mr360uw.composite.grading.patch_solve import ORDER, Patch, solve_patches
from mr360uw.composite.grading.settings import COLOUR, LEAST_STEP, MatchSettings, PatchSettings
from mr360uw.composite.tiles import empty_tile
from mr360uw.errors import ParameterError
from mr360uw.types import Floats, Layer, Rectangle, YuvImage
from mr360uw.video import VideoFrame
from tests.composite import tolerances as tol

GRADES = {
    "lifted": ColourGrade((0.06, 0.06, 0.06), (0.9, 0.9, 0.9)),
    "crushed, tinted": ColourGrade((-0.03, -0.02, 0.01), (1.0, 0.95, 1.1)),
    "more contrast": ColourGrade(contrast=1.4),
    "less contrast": ColourGrade(contrast=0.5),
    "brighter": ColourGrade(gamma=0.8),
    "more colour": ColourGrade(saturation=1.4),
    "all": ColourGrade((0.05, 0.03, 0.06), (0.92, 0.9, 0.95), 1.2, 0.8, 0.6),
}
SPECS = {
    "srgb": ColorSpec(),
    "gamma 2.4, bt601": ColorSpec("bt601", transfer="bt1886"),
    "log, wide gamut": ColorSpec(transfer="gplog", bits=10, primaries="bt2020"),
    "linear": ColorSpec("bt709", True, "linear", 32),
}


@pytest.mark.parametrize("name", GRADES)
def test_taking_a_grade_off_is_the_inverse_of_laying_it_on(name: str) -> None:
    grade, rng = GRADES[name], np.random.default_rng(4)
    code = rng.uniform(-0.1, 1.2, (40, 50, 3))
    np.testing.assert_allclose(grade.ungraded(grade.graded(code)), code, atol=tol.GRADE_INVERSE)
    for spec in SPECS.values():
        own = ColorSpec() if spec.transfer == "linear" else spec
        light = in_rec709(decode_signal(rng.uniform(0.1, 0.95, (400, 3)), own), spec)
        np.testing.assert_allclose(
            grade.take_off(grade.lay_on(light, spec), spec), light, rtol=tol.GRADE_FLOAT32, atol=1e-4
        )


def test_light_of_any_code_is_neither_negative_nor_absurd() -> None:
    """Corners of all codes in narrow and wide primaries, under each combination of levels, curve and saturation that
    settings take; those whose white would be brighter than the limit are refused."""
    corners = np.array(list(itertools.product((0.0, 0.5, 1.0), repeat=3)), np.float32)
    taken = 0
    for numbers in itertools.product((-0.3, 0.3), (0.5, 1.0, 1.6), (0.3, 3.0), (0.3, 1.45), (0.1, 4.0)):
        settings = dict(zip(COLOUR, numbers, strict=True))
        white = ColourGrade((numbers[0],) * 3, (numbers[1],) * 3, *numbers[2:]).ungraded(np.ones((1, 3)))
        if numbers[1] - numbers[0] > LEAST_STEP and decode(white, "srgb").max() > MOST_LIGHT:
            with pytest.raises(ParameterError, match="times as bright as white"):
                MatchSettings(**settings)
        elif numbers[1] - numbers[0] > LEAST_STEP:
            grade, taken = MatchSettings(**settings).colour_over(NO_GRADE), taken + 1
            for spec in SPECS.values():
                own = graded_spec(spec)
                shown = decode_signal(corners, own)
                light = in_plate_primaries(grade.take_off(in_rec709(shown, own), spec), own)
                assert np.all(np.isfinite(light))
                # float32 through two matrices
                assert light.min() >= -1e-5 * MOST_LIGHT
                assert light.max() <= 1.0001 * max(MOST_LIGHT, float(shown.max()))
    assert taken > 20


def test_each_number_does_what_it_says() -> None:
    grey = np.array([0.0, 0.25, 0.5, 0.75, 1.0])[:, None] * np.ones(3)
    lifted = ColourGrade((0.1, 0.1, 0.1), (0.9, 0.9, 0.9)).graded(grey)
    np.testing.assert_allclose(lifted, 0.1 + 0.8 * grey, atol=1e-12)
    np.testing.assert_allclose(ColourGrade(gamma=0.8).graded(grey), grey**0.8, atol=1e-12)
    curve = ColourGrade(contrast=1.4).graded(grey)
    smoothstep = grey**2 * (3.0 - 2.0 * grey)
    np.testing.assert_allclose(curve, 0.2 * grey + 0.8 * smoothstep, atol=1e-12)  # slopes 1 and 1.5 give 1.4
    colour = np.array([[0.2, 0.5, 0.6]])
    luma = colour @ [0.2126, 0.7152, 0.0722]
    np.testing.assert_allclose(ColourGrade(saturation=1.4).graded(colour), luma + 1.4 * (colour - luma), atol=1e-12)
    assert not NO_GRADE.changes
    black, white, *others = astuple(GRADES["all"])
    assert GRADES["all"].numbers.tolist() == [*black, *white, *others]


def frame_of(codes: Floats) -> VideoFrame:
    """Return a frame of 10-bit 4:4:4 planes that show R'G'B' codes (H, W, 3) of grey."""
    spec = ColorSpec(full_range=True, bits=10)
    luma = np.rint(1023.0 * codes[..., 0]).astype(np.uint16)
    grey = np.full_like(luma, 512)
    return VideoFrame(0, 0, Fraction(1), 0.0, 0, spec, yuv=YuvImage(luma, grey, grey, spec))


@pytest.mark.parametrize("name", ["lifted", "more contrast", "brighter"])
def test_a_composite_over_a_graded_plate_is_the_grade_of_the_composite(name: str) -> None:
    """A body, its edge, a shadow and a shaft, on a ramp; within the rounding of both plates to 10 bits."""
    grade, ramp = GRADES[name], np.linspace(0.2, 0.8, 32)[None, :, None] * np.ones((16, 1, 3))
    tile = empty_tile(Rectangle(4, 2, 24, 12))
    alpha, ratio = tile.alpha.copy(), tile.ratio.copy()
    alpha[3:6, 3:9], alpha[6, 3:9] = 1.0, 0.5
    ratio[:, 12:18] = 0.5
    shafts = np.zeros_like(tile.radiance)
    shafts[:, 20:] = 0.02
    radiance = alpha[..., None] * np.float32([0.3, 0.3, 0.3])
    tile = replace(tile, alpha=alpha, ratio=ratio, radiance=radiance, veil=tile.veil + np.float32(0.02), shafts=shafts)
    layer = Layer(16, 32, (tile,))
    plain, graded = frame_of(ramp), frame_of(grade.graded(ramp))
    truth = grade.graded(encode(plain.over(layer).image_linear, "srgb"))
    made = graded.graded_by(grade).over(layer)
    assert made.grade is None
    np.testing.assert_allclose(encode(made.image_linear, "srgb"), truth, atol=tol.GRADED_COMPOSITE)
    assert graded.yuv is not None
    assert made.yuv is not None
    untouched = np.ones((16, 32), bool)
    untouched[2:14, 4:28] = False
    np.testing.assert_array_equal(made.yuv.y[untouched], graded.yuv.y[untouched])
    np.testing.assert_array_equal(made.yuv.y[2:4, 7:12], graded.yuv.y[2:4, 7:12])  # in the tile, but not changed
    np.testing.assert_allclose(
        graded.graded_by(grade).image_linear, plain.image_linear, rtol=tol.GRADED_LIGHT, atol=1e-4
    )


def test_a_frame_without_a_grade_is_itself() -> None:
    frame = frame_of(np.full((4, 8, 3), 0.5))
    assert frame.graded_by(None) is frame
    graded = frame.graded_by(GRADES["lifted"])
    assert graded.pixels is not graded.yuv
    assert frame.pixels is frame.yuv
    assert graded.over(Layer(4, 8, ())).grade is None


def patch(grade: ColourGrade, *reflectance: float) -> Patch:
    """Return a patch under bluish light, in a plate with a grade."""
    reflected = np.broadcast_to(np.array(reflectance), 3)
    red, green, blue = grade.graded(encode(reflected * np.array([0.3, 0.6, 0.7]), "srgb"))
    return Patch((red, green, blue), (float(reflected[0]), float(reflected[1]), float(reflected[2])))


COLOURED = (0.6, 0.1, 0.05), (0.05, 0.1, 0.6)


@pytest.mark.parametrize(
    ("reflectances", "told"),
    [
        ([(0.18,)], ()),
        ([(0.0,)], ("black",)),
        ([(0.0,), (0.18,)], ("black",)),
        ([(0.0,), (0.18,), (0.9,)], ("black", "gamma", "contrast")),
        ([(0.0,), (0.18,), (0.9,), *COLOURED], ("black", "gamma", "contrast", "saturation")),
    ],
)
def test_patches_tell_what_they_determine_and_no_more(
    reflectances: list[tuple[float, ...]], told: tuple[str, ...]
) -> None:
    grade = ColourGrade(gamma=0.9, contrast=1.2, saturation=1.3 if "saturation" in told else 1.0)
    if told:
        grade = replace(grade, black=(0.06, 0.05, 0.04))
    colour, names, words = solve_patches([patch(grade, *one) for one in reflectances], NO_GRADE, ORDER)
    assert names == told
    for name in told:
        # saturation mixes the three blacks; a code of 255 is 0.004
        close = tol.PATCH_BLACK if name == "black" else tol.PATCH_NUMBER
        np.testing.assert_allclose(getattr(colour, name), getattr(grade, name), atol=close, err_msg=name)
    untold = [name for name in ORDER if name not in told]
    assert all(getattr(colour, name) == getattr(NO_GRADE, name) for name in untold)
    assert all(name in words for name in told)


def test_given_numbers_stay_and_contradictions_are_said() -> None:
    grade = ColourGrade(gamma=0.8, contrast=1.2)
    patches = [patch(grade, one) for one in (0.0, 0.18, 0.9)]
    start = replace(NO_GRADE, contrast=1.2)
    colour, told, _ = solve_patches(patches, start, ("gamma",))
    assert told == ("gamma",)
    assert colour == replace(start, gamma=pytest.approx(0.8, abs=tol.PATCH_NUMBER))
    wrong = [*patches, Patch(patches[1].code, (0.6, 0.6, 0.6))]
    assert "contradict" in solve_patches(wrong, start, ("gamma",))[2]
    with pytest.raises(ParameterError, match="patches - none"):
        solve_patches([], start, ("gamma",))


def test_settings_say_what_is_wrong() -> None:
    place = {"azimuth_deg": 10.0, "elevation_deg": -5.0}
    for given, message in (
        ({"is": "black", "reflectance": 0.1}, "black has none"),
        ({"is": "grey", "reflectance": (0.1, 0.2, 0.3)}, "is one number"),
        ({"is": "colour", "reflectance": 0.1}, "is three numbers"),
    ):
        with pytest.raises(ValueError, match=message):
            PatchSettings.model_validate(place | given)
    with pytest.raises(ValueError, match=r"white - must be 0\.2 above black"):
        MatchSettings(black=0.4, white=(1.0, 0.5, 1.0))
    given_black = MatchSettings(black=(0.1, 0.0, 0.0), gamma=0.9)
    assert given_black.colour_over(GRADES["lifted"]) == ColourGrade((0.1, 0.0, 0.0), (0.9, 0.9, 0.9), 0.9)
    assert given_black.open_keys == ()  # without a patch nothing is looked for
    patched = MatchSettings(black=0.1, gamma=0.9, patch=(PatchSettings.model_validate(place),))
    assert patched.open_keys == ("white", "contrast", "saturation")


def test_strong_saturation_takes_no_more_light_than_there_is() -> None:
    """Over a floating point plate, which has no range of codes: red and green, four times as saturated."""
    light = np.full((8, 16, 3), 0.4, np.float32)
    part = Rectangle(2, 2, 4, 4)
    radiance = np.zeros((4, 4, 3), np.float32) + np.float32([0.9, 0.3, 0.1])
    tile = replace(empty_tile(part), radiance=radiance, alpha=np.ones((4, 4), np.float32))
    plate = VideoFrame.of_linear(light).graded_by(ColourGrade(saturation=4.0))
    shown = plate.over(Layer(8, 16, (tile,))).light
    assert shown.min() >= 0.0
    assert shown.max() > 0.9
