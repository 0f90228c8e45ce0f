# SPDX-License-Identifier: Apache-2.0
"""Plates are read through lookup tables and OpenColorIO, and what is drawn goes back into their codes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import colour
import cv2
import numpy as np
import pytest
from colour.algebra import table_interpolation_tetrahedral

import mr360uw as uw
from mr360uw.base.color import ColorSpec, decode, in_plate_primaries, in_rec709
from mr360uw.errors import ParameterError, VideoError
from mr360uw.scene.model import Scene, scene_from_dict
from mr360uw.scene.resolved import open_plate
from mr360uw.types import Tile
from mr360uw.video import open_video, read_picture
from mr360uw.video.planes import lay_over_planes
from mr360uw.yuv.decoding import linear_from_planes, linear_in_directions
from mr360uw.yuv.ocio_transform import OcioSettings, cube_mapping, ocio_mapping
from tests.video.clips import write_clip, yuv_image
from tests.video.test_hdr import lamp_scene
from tests.video.tolerances import VIDEO_LUT, VIDEO_LUT_CODES, VIDEO_LUT_LINE, VIDEO_OCIO

_MIX = np.array([[0.8, 0.15, 0.05], [0.1, 0.8, 0.1], [0.05, 0.1, 0.85]])


def grid(size: int) -> np.ndarray:
    axis = np.linspace(0.0, 1.0, size)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)


def rows(values: np.ndarray) -> str:
    return "".join("{:.7f} {:.7f} {:.7f}\n".format(*row) for row in values.reshape(-1, 3))


def cube(path: Path, values: np.ndarray, head: str = "") -> Path:
    """Write values (n, n, n, 3) for red, green, blue; red changes fastest in the file."""
    text = f'# made by hand\nTITLE "test"\n{head}LUT_3D_SIZE {len(values)}\n\n{rows(values.transpose(2, 1, 0, 3))}'
    path.write_text(text, "utf-8")
    return path


def curve(path: Path, values: np.ndarray, head: str = "") -> Path:
    path.write_text(
        f"LUT_1D_SIZE {len(values)}\n{head}# a curve\n{rows(np.repeat(values[:, None], 3, axis=1))}", "utf-8"
    )
    return path


def slog3(signal: np.ndarray) -> np.ndarray:
    return np.asarray(colour.models.log_decoding(signal, "S-Log3"))


def camera_look(path: Path) -> Path:
    """A log camera's table for viewing: gamut, tone curve, gamma, clipped at both ends."""
    to_709 = colour.matrix_RGB_to_RGB("S-Gamut3.Cine", "ITU-R BT.709")
    light = np.maximum(slog3(grid(33)) @ to_709.T, 0.0)
    return cube(path, np.clip((1.02 * light / (light + 0.16)) ** (1 / 2.4), 0.0, 1.0))


def test_a_cube_is_interpolated_by_tetrahedra(tmp_path: Path, rng: np.random.Generator) -> None:
    table = grid(5) ** 1.4 @ _MIX.T
    lut = cube_mapping(cube(tmp_path / "a.cube", table), "linear", "video")
    values = rng.uniform(0.0, 1.0, (500, 3))
    known = colour.LUT3D(table).apply(values, interpolator=table_interpolation_tetrahedral)
    np.testing.assert_allclose(lut.to_light(values), known, atol=VIDEO_LUT)


@pytest.mark.parametrize(
    ("name", "to"),
    [
        ("mixed", "srgb"),
        ("mixed", "linear"),
        ("domain", "bt709"),
        ("curve", "linear"),
        ("range", "srgb"),
        ("both", "srgb"),
    ],
)
def test_tables_there_and_back(tmp_path: Path, rng: np.random.Generator, name: str, to: Any) -> None:
    path, low, high = tmp_path / "a.cube", 0.0, 1.0
    if name == "mixed":
        cube(path, grid(17) ** 1.4 @ _MIX.T)
    elif name == "domain":
        low, high = -0.25, 1.5
        cube(path, grid(9) ** 1.2 @ _MIX.T, f"DOMAIN_MIN {low} {low} {low}\nDOMAIN_MAX {high} {high} {high}\n")
    elif name == "curve":
        curve(path, slog3(np.linspace(0.0, 1.0, 257)))
    elif name == "range":
        low, high = -0.1, 1.2
        curve(path, np.linspace(0.0, 1.0, 65) ** 0.7, f"LUT_1D_INPUT_RANGE {low} {high}\n")
    else:
        shaper, table = np.linspace(0.0, 1.0, 33) ** 0.5, grid(9) @ _MIX.T
        path.write_text(
            "LUT_1D_SIZE 33\nLUT_1D_INPUT_RANGE 0.0 1.0\nLUT_3D_SIZE 9\nLUT_3D_INPUT_RANGE 0.0 1.0\n"
            + rows(np.repeat(shaper[:, None], 3, axis=1)) + rows(table.transpose(2, 1, 0, 3)), "utf-8",
        )  # fmt: skip
    values = rng.uniform(low, high, (1000, 3))
    lut = cube_mapping(path, to, "video")
    assert np.abs(lut.to_values(lut.to_light(values)) - values).max() < VIDEO_LUT


def test_a_camera_s_table_that_clips_goes_back_where_it_does_not(tmp_path: Path, rng: np.random.Generator) -> None:
    lut = cube_mapping(camera_look(tmp_path / "look.cube"), "srgb", "video")
    values = 0.3 + 0.4 * rng.uniform(0.0, 1.0, (1000, 1)) + 0.08 * rng.uniform(-0.5, 0.5, (1000, 3))
    assert np.abs(lut.to_values(lut.to_light(values)) - values).max() < VIDEO_LUT
    white, black = lut.to_light(np.ones(3)), lut.to_light(np.zeros(3))
    back = lut.to_values(np.stack([white, black, 5.0 * white]))
    np.testing.assert_allclose(lut.to_light(back), [white, black, white], atol=VIDEO_LUT)
    # to 0.001: the vertices 2/32 before black, code 95 of 1023, and 27/32 after light of 8, at which the tone is 1
    assert lut.clipped_greys == "below 0.062 and above 0.844"
    assert 0.5 < back[0].min() < 1.0, "of the codes that clip, the first"
    assert back[1].max() <= 0.0625, "and one of them at black"


def with_lut(scene: Scene, **more: Any) -> Scene:
    """Return a scene with changes of its plate."""
    return scene.model_copy(update={"plate": scene.plate.model_copy(update=more)})


def test_a_table_of_a_curve_is_that_curve(tmp_path: Path, rng: np.random.Generator) -> None:
    """A composite by a table that holds sRGB values as they are is the one by the curve itself."""
    plate = tmp_path / "plate.png"
    cv2.imwrite(str(plate), rng.integers(60, 200, (64, 128, 3), dtype=np.uint8))
    scene = lamp_scene(tmp_path, plate)
    table = cube(tmp_path / "same.cube", grid(3))
    made = {}
    for name, own in (("curve", scene), ("table", with_lut(scene, lut=table, lut_to="srgb"))):
        with open_plate(own) as video:
            light = next(iter(video.frames(0, 1))).image_linear
        uw.composite_video(own, tmp_path / f"{name}.png", frames=(0, 1))
        made[name] = light, read_picture(tmp_path / f"{name}.png").astype(int)
    np.testing.assert_allclose(made["table"][0], made["curve"][0], atol=VIDEO_LUT)
    assert np.abs(made["table"][1] - made["curve"][1]).max() <= VIDEO_LUT_CODES
    assert made["table"][1][32, 64].min() == 255, "the lamp"


def test_light_goes_into_planes_through_the_table(tmp_path: Path, rng: np.random.Generator) -> None:
    old = yuv_image()
    table = cube_mapping(cube(tmp_path / "same.cube", grid(3)), "srgb", "video")
    light = rng.uniform(0.0, 1.0, (20, 30, 3)).astype(np.float32)
    cover = rng.uniform(0.0, 1.0, (20, 30)).astype(np.float32)
    tile, made = Tile(10, 8, light, cover, cover, np.ones_like(light), light), []
    for spec in (old.spec, old.spec.mapped(table)):
        own, new = replace(old, spec=spec), replace(old, spec=spec, y=old.y.copy(), u=old.u.copy(), v=old.v.copy())
        lay_over_planes(own, new, tile, 0, composite=light)
        made.append(np.concatenate([plane.ravel().astype(int) for plane in (new.y, new.u, new.v)]))
    assert np.abs(made[1] - made[0]).max() <= VIDEO_LUT_CODES
    assert np.abs(made[0] - np.concatenate([p.ravel() for p in (old.y, old.u, old.v)])).max() > 10


@pytest.mark.parametrize("levels", ["video", "data"])
def test_levels_say_what_0_and_1_are(tmp_path: Path, levels: Any) -> None:
    table = cube_mapping(curve(tmp_path / "a.cube", np.linspace(0.0, 1.0, 2)), "linear", levels)
    spec = ColorSpec().mapped(table)
    signal = np.array([0.0, 0.5, 1.0])[:, None] * np.ones(3)
    wanted = signal if levels == "video" else (16.0 + 219.0 * signal) / 255.0
    np.testing.assert_allclose(in_rec709(signal, spec), wanted, atol=VIDEO_LUT_LINE)  # a line
    np.testing.assert_allclose(in_plate_primaries(in_rec709(signal, spec), spec), signal, atol=VIDEO_LUT_LINE)


def test_every_reader_of_a_plate_s_light_sees_the_table(tmp_path: Path) -> None:
    table = cube_mapping(cube(tmp_path / "a.cube", grid(9) @ _MIX.T), "linear", "video")
    plain, mapped = (yuv_image(0, s) for s in (ColorSpec(transfer="linear"), ColorSpec().mapped(table)))
    rectangle = linear_from_planes(plain)
    np.testing.assert_allclose(linear_from_planes(mapped), np.clip(rectangle, 0, 1) @ _MIX.T, atol=VIDEO_LUT)
    ways = np.array([[0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [0.0, 0.6, -0.8]])
    light = linear_in_directions(mapped, ways)
    np.testing.assert_allclose(light, linear_in_directions(plain, ways) @ _MIX.T, atol=VIDEO_LUT)
    assert replace(mapped.spec).mapping == cube_mapping(tmp_path / "a.cube", "linear", "video"), (
        "equal by what it holds"
    )


_FOLDED = grid(5)
_FOLDED[2, 2, 2] = 0.9
UNREADABLE, ONE_WAY = "is no .cube table that can be read", "cannot be turned around"
BAD = {
    "no table": ("TITLE nothing\n", UNREADABLE),
    "size": ("LUT_3D_SIZE 100000\n", "must be between 2 and 129"),
    "rows": ("LUT_1D_SIZE 3\n0 0 0\n1 1 1\n", "Found 2, expected 3"),
    "columns": ("LUT_1D_SIZE 2\n0 0 0\n1 1\n", "At line (3)"),
    "text": ("LUT_1D_SIZE 2\n0 0 0\n1 1 0x\n", ONE_WAY),
    "keyword": ("LUT_IN_VIDEO_RANGE\nLUT_1D_SIZE 2\n0 0 0\n1 1 1\n", "At line (1): 'LUT_IN_VIDEO_RANGE'"),
    "short domain": ("DOMAIN_MAX 1\nLUT_1D_SIZE 2\n0 0 0\n1 1 1\n", "Malformed 'DOMAIN_MAX' tag"),
    "endless domain": ("LUT_1D_SIZE 2\nDOMAIN_MAX inf 1 1\n0 0 0\n1 1 1\n", UNREADABLE),
    "huge": ("LUT_1D_SIZE 2\n0 0 0\n1e300 1e300 1e300\n", UNREADABLE),
    "constant cube": ("LUT_3D_SIZE 2\n" + "0 0 0\n" * 8, ONE_WAY),
    "infinite": ("LUT_1D_SIZE 2\n0 0 0\n1 1 1e999\n", UNREADABLE),
    "domain": ("DOMAIN_MIN 1 1 1\nDOMAIN_MAX 0 0 0\nLUT_1D_SIZE 2\n0 0 0\n1 1 1\n", ONE_WAY),
    "falls": ("LUT_1D_SIZE 4\n0 0 0\n.6 .6 .6\n.4 .4 .4\n1 1 1\n", ONE_WAY),
    "negative": ("LUT_1D_SIZE 2\n1 1 1\n0 0 0\n", "white is not above black"),
    "constant": ("LUT_1D_SIZE 2\n.5 .5 .5\n.5 .5 .5\n", ONE_WAY),
    "folds": (f"LUT_3D_SIZE 5\n{rows(_FOLDED)}", "(got it at input R 0."),
    "grey": (
        f"LUT_3D_SIZE 3\n{rows(np.repeat(0.2 + 0.6 * grid(3).mean(axis=-1)[..., None], 3, axis=-1))}",
        ONE_WAY,
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_tables_that_cannot_be_used_are_refused(tmp_path: Path, run: Callable[..., Any], name: str) -> None:
    text, message = BAD[name]
    path = tmp_path / "bad.cube"
    path.write_text(text, "utf-8")
    with pytest.raises(VideoError, match=r"bad\.cube") as caught:
        cube_mapping(path, "srgb", "video")
    assert message in str(caught.value)
    assert str(caught.value).count(" - ") >= 2
    if name == "folds":
        write_clip(tmp_path / "plate.mp4", 1)
        (tmp_path / "scene.toml").write_text('[plate]\npath = "plate.mp4"\nlut = "bad.cube"\n', "utf-8")
        code, _, errors = run("check", tmp_path / "scene.toml")
        assert code == 2
        assert message in errors


@pytest.mark.parametrize(
    "text",
    [
        "\ufeffLUT_1D_SIZE 2\n{}", "LUT_1D_SIZE 2\r\n{}", 'TITLE "é LUT_3D_SIZE 9"\n  LUT_1D_SIZE\t2\n{}',
        "LUT_1D_SIZE 2\nLUT_3D_SIZE 2\n{}" + rows(grid(2).transpose(2, 1, 0, 3)),
    ],
    ids=["byte order mark", "other line ends", "title and tabs", "shaper without ranges"],
)  # fmt: skip
def test_tables_as_other_programs_write_them(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.cube"
    path.write_bytes(text.format("0 0 0\n1 .5 1\n").encode())
    values = np.array([0.2, 0.4, 0.6])
    light = cube_mapping(path, "linear", "video").to_light(values)
    np.testing.assert_allclose(light, [0.2, 0.2, 0.6], atol=VIDEO_LUT_LINE)  # a line


@pytest.mark.parametrize(
    ("plate", "message"),
    [
        ({"lut": "a.cube", "transfer": "slog3"}, "lut and transfer all say"),
        ({"lut": "a.cube", "ocio": {"input": "ACEScg"}}, "lut and ocio all say"),
        ({"ocio": {"input": "ACEScg", "config": "studio"}}, "plate.ocio.config - no such file"),
        ({"ocio": {}}, "input"),
        ({"lut_to": "linear"}, "lut_to - is of a lookup table, and there is none"),
        ({"ocio": {"input": "ACEScg"}, "lut_to": "linear"}, "lut_to - is of a lookup table"),
        ({"levels": "data"}, "levels - is of lut or ocio, and there is neither"),
    ],
)
def test_only_one_thing_says_what_values_mean(tmp_path: Path, plate: dict[str, Any], message: str) -> None:
    cube(tmp_path / "a.cube", grid(2))
    write_clip(tmp_path / "plate.mp4", 1)
    with pytest.raises(uw.SceneError, match=message):
        scene_from_dict({"plate": {"path": "plate.mp4", **plate}}, tmp_path)


def test_ocio_reads_a_log_camera_as_its_curve_does(tmp_path: Path) -> None:
    write_clip(tmp_path / "plate.mp4", 4, pixel_format="yuv420p10le", codec="libx265")
    light = {}
    for name, table in {
        "curve": {"transfer": "slog3", "primaries": "sgamut3cine"},
        "ocio": {"ocio": {"input": "S-Log3 S-Gamut3.Cine"}, "levels": "data"},
    }.items():
        with open_plate(scene_from_dict({"plate": {"path": "plate.mp4", **table}}, tmp_path)) as video:
            frame = next(iter(video.frames(0, 1)))
            light[name] = frame.image_linear
            values = in_plate_primaries(frame.image_linear, frame.spec)
            again = in_rec709(values, frame.spec) if name == "ocio" else frame.image_linear
    scale = np.abs(light["curve"]).max()
    np.testing.assert_allclose(light["ocio"] / scale, light["curve"] / scale, atol=VIDEO_OCIO)
    np.testing.assert_allclose(again / scale, light["ocio"] / scale, atol=VIDEO_LUT)
    with pytest.raises(ParameterError, match=r"plate\.ocio\.input - is no colour space of .*Nikon"):
        ocio_mapping(OcioSettings(input="Nikon"), "video")
    with pytest.raises(VideoError, match="is no OpenColorIO config"):
        ocio_mapping(OcioSettings(input="x", config="ocio://none"), "video")


def test_a_curve_in_a_table_reads_as_the_named_one(tmp_path: Path) -> None:
    """S-Log3 as 4096 samples to light, on the file's codes, as its maker defines it."""
    plate = write_clip(tmp_path / "plate.mp4", 4, pixel_format="yuv420p10le", codec="libx265")
    table = cube_mapping(curve(tmp_path / "slog3.cube", slog3(np.linspace(0.0, 1.0, 4096))), "linear", "data")
    with open_video(plate, "slog3", primaries="bt709") as video:
        frame = next(iter(video.frames(0, 1)))
    assert frame.yuv is not None
    mapped = replace(frame.yuv, spec=frame.spec.mapped(table))
    ends = slog3(np.array([0.0, 1.0]))  # beyond which the table holds
    np.testing.assert_allclose(
        linear_from_planes(mapped), frame.image_linear.clip(*ends), rtol=VIDEO_LUT, atol=VIDEO_LUT
    )
    assert float(decode(np.array(0.5), "slog3")) == pytest.approx(float(table.to_light(np.full(3, 0.5))[0]), rel=1e-4)
