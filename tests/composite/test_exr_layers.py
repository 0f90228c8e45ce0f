# SPDX-License-Identifier: Apache-2.0
"""The layered EXR as other programs find it: names, types, windows, and the composite from the file alone."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from mr360uw.base.color import XY_BY_NAME
from mr360uw.base.sphere import frame_from_direction, yaw_matrix
from mr360uw.composite.aovs import RECIPE, Aovs, cryptomatte, exr_parts, motion, murmur
from mr360uw.composite.reference import render_aovs
from mr360uw.composite.shot import PlacedObject, Receiver, Shot
from mr360uw.composite.tiles import over
from mr360uw.render.frame import Gl
from mr360uw.types import Floats
from mr360uw.video import write_exr
from tests.composite import tolerances as tol
from tests.composite.scenes import medium, placed, plate, shot, sphere

COLOURS = (
    "diffuse", "glossy", "sun", "lamps", "caustics", "emission", "veil", "shafts", "snow", "transmittance",
    "shadow_ratio", "plate_shafts", "receiver_difference",
)  # fmt: skip
EXPECTED = {
    "rgba": ("half", "A B G R"),
    "depth": ("float", "Z"),
    "N": ("half", "N.X N.Y N.Z"),
    "P": ("float", "P.X P.Y P.Z"),
    "id": ("uint", "id.Y"),
    **{name: ("half", f"{name}.B {name}.G {name}.R") for name in COLOURS},
}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Floats, Floats]:
    """A file of layers, the plate below it, and their composite."""
    body = placed(sphere(), (0.1, -0.5, -1.2))
    layer, variables = render_aovs(shot(body, width=64, medium=medium(), receiver=Receiver(plane_y=-1.2)))
    ground = plate(64)
    path = tmp_path_factory.mktemp("layers") / "layers_0000.exr"
    write_exr(path, exr_parts(layer, variables, ground), attributes={"comments": RECIPE})
    return path, ground, over(ground, layer)


def test_names_types_and_header(written: tuple[Path, Floats, Floats]) -> None:
    kinds = {np.float16: "half", np.float32: "float", np.uint32: "uint"}
    with OpenEXR.File(str(written[0]), separate_channels=True) as file:
        found = {
            part.name(): (kinds[next(iter(part.channels.values())).pixels.dtype.type], " ".join(sorted(part.channels)))
            for part in file.parts
        }
        assert found == EXPECTED
        assert file.parts[0].name() == "rgba"  # what programs that know one part show
        every = [channel for part in file.parts for channel in part.channels]
        assert len(set(every)) == len(every)  # so that programs that pour all parts together lose none
        for part in file.parts:
            assert part.header["envmap"] == OpenEXR.ENVMAP_LATLONG
            np.testing.assert_allclose(part.header["chromaticities"], [0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329])
            assert part.header["comments"] == RECIPE
            for window in ("dataWindow", "displayWindow"):
                np.testing.assert_array_equal(part.header[window], [(0, 0), (63, 31)])


def test_another_library_lists_it_and_rebuilds_the_composite(written: tuple[Path, Floats, Floats]) -> None:
    oiio = pytest.importorskip("OpenImageIO", reason="OpenImageIO is not installed: pip install OpenImageIO")
    path, ground, expected = written
    parts, found = {}, {}
    for number in range(len(EXPECTED)):
        buffer = oiio.ImageBuf(str(path), number, 0)
        spec = buffer.spec()
        found[spec["name"]] = (str(spec.format), " ".join(sorted(spec.channelnames)))
        parts[spec["name"]] = buffer.get_pixels(oiio.FLOAT)
        assert (spec.full_width, spec.full_height, spec.x, spec.y) == (64, 32, 0, 0)
    assert found == EXPECTED
    assert oiio.ImageBuf(str(path)).spec()["textureformat"] == "LatLong Environment"
    rgb, alpha = parts["rgba"][..., :3], parts["rgba"][..., 3:]
    np.testing.assert_allclose(
        rgb + (1.0 - alpha) * (ground + parts["receiver_difference"]), expected, atol=tol.HALF_FLOAT
    )
    total = sum(parts[name] for name in ("diffuse", "glossy", "sun", "lamps", "emission", "veil"))
    np.testing.assert_allclose(total, rgb, atol=tol.HALF_FLOAT)


def test_what_is_too_bright_for_half_floats_stays_finite() -> None:
    layer, variables = render_aovs(shot(placed(sphere(), (0.0, 0.0, -1.2)), width=32))
    bright = [replace(tile, radiance=np.full_like(tile.radiance, 1e6)) for tile in layer.tiles]
    parts = exr_parts(replace(layer, tiles=tuple(bright)), variables, plate(32))
    assert np.all(np.isfinite(parts["rgba"]["RGBA"]))
    assert parts["rgba"]["RGBA"].max() == np.finfo(np.float16).max


def test_the_program_that_asks_other_readers_finds_what_they_read_otherwise(
    written: tuple[Path, Floats, Floats],
) -> None:
    from benchmarks.peers.reads import by_openexr, by_openimageio, differences

    pytest.importorskip("OpenImageIO", reason="OpenImageIO is not installed: pip install OpenImageIO")
    expected, found = by_openexr(written[0])[1], by_openimageio(written[0])[1]
    assert [what for _, what in differences(expected, found)] == [""] * len(EXPECTED)
    depth = found["depth"]
    for changed, says in (
        (replace(depth, channels={"Z": depth.channels["Z"] * (1.0 + 3e-6)}), "is off by"),
        (replace(depth, channels={"z": depth.channels["Z"]}), "no channel Z"),
        (replace(depth, kind="half"), "type half"),
        (replace(depth, window=(1, 0, 64, 32)), "window"),
    ):
        assert says in dict(differences(expected, found | {"depth": changed}))["depth"]
    del found["id"]
    assert dict(differences(expected, found))["id"] == "not listed"


# --- Motion and Cryptomatte -------------------------------------------------------------------------------------------


def variables_of(*bodies: PlacedObject, **more: Any) -> tuple[Aovs, Shot, Floats]:
    """Return the output variables of bodies, their shot and its coverage."""
    scene = shot(*bodies, width=128, sun=None, **more)
    layer, variables = render_aovs(scene)
    return variables, scene, layer.alpha


def test_a_turning_camera_moves_everything_by_its_angle() -> None:
    """Also over the seam: the shorter way counts."""
    bodies = placed(sphere(), (0.1, -0.5, -2.2)), placed(sphere(), (0.0, 0.3, 2.0))
    variables, scene, alpha = variables_of(*bodies)
    view = replace(scene.view, world_from_camera=yaw_matrix(np.radians(20.0)))
    moved = motion(variables, scene, bodies, view)
    there = variables.object_id > 0
    right = view.world_from_camera.T @ [0.0, 0.0, -1.0]
    angle = np.arctan2(right[0], -right[2])
    np.testing.assert_allclose(moved[there, 0], angle / (2.0 * np.pi) * 128, atol=tol.PIXELS_MOVED)
    np.testing.assert_allclose(moved[there, 1], 0.0, atol=tol.PIXELS_MOVED)
    assert not np.any(moved[alpha == 0.0])
    assert not np.any(motion(variables, scene, bodies, scene.view))


def test_points_of_a_body_that_moves_and_grows_are_followed() -> None:
    middle = np.array([0.1, -0.4, -2.0])
    variables, scene, _ = variables_of(placed(sphere(), middle))
    step = np.array([0.3, 0.2, 0.1])
    then = placed(sphere(), middle + step)
    then = replace(then, mesh=replace(then.mesh, positions=1.2 * then.mesh.positions))
    moved, there = motion(variables, scene, [then], scene.view), variables.object_id > 0
    now = variables.position[there]
    places = [frame_from_direction(p, 128, 64) for p in (now, middle + step + 1.2 * (now - middle))]
    expected = np.stack([places[1][0] - places[0][0], places[0][1] - places[1][1]], axis=-1)
    np.testing.assert_allclose(moved[there], expected, atol=tol.MEAN_POINT)


@pytest.mark.parametrize(("text", "number"), [
    ("", 0), ("hello", 0x248BFA47), ("hello, world", 0x149BBB7F),
    ("The quick brown fox jumps over the lazy dog", 0x2E4FF723),
])  # fmt: skip
def test_hashes_are_those_of_murmur(text: str, number: int) -> None:
    assert murmur(text) == number


@pytest.mark.parametrize("backend", ["reference", "gl"])
def test_a_cryptomatte_names_what_covers_each_pixel(backend: str, request: pytest.FixtureRequest) -> None:
    near, far = placed(sphere(), (0.2, -0.3, -1.5)), placed(sphere(), (-0.4, -0.2, -2.5))
    variables, scene, alpha = variables_of(near, far)
    if backend == "gl":
        request.getfixturevalue("gl")
        layer, found = Gl().layer(scene, variables=True)
        assert found is not None
        variables, alpha = found, layer.alpha
    parts, header = cryptomatte(variables, scene, ["whale", "wreck"])
    told = {key.rsplit("/", 1)[1]: value for key, value in header.items() if value and "Object" in header[_name(key)]}
    names = {np.uint32(int(bits, 16)).view(np.float32): name for name, bits in json.loads(told["manifest"]).items()}
    assert sorted(names.values()) == ["whale", "wreck"]
    of = {name: image for k in range(3) for name, image in parts[f"CryptoObject{k:02d}"].items()}
    pairs = [
        (of[f"CryptoObject{k:02d}.{a}"], of[f"CryptoObject{k:02d}.{b}"]) for k in range(3) for a, b in ("RG", "BA")
    ]
    np.testing.assert_allclose(sum(cover for _, cover in pairs), alpha, atol=tol.FLOAT32)
    assert all(np.all(one[1] >= other[1]) for one, other in pairwise(pairs))
    first = np.vectorize(lambda bits: {"whale": 1, "wreck": 2}.get(names.get(bits, ""), 0))(pairs[0][0])
    np.testing.assert_array_equal(first[alpha > 0.99], variables.object_id[alpha > 0.99])
    both = (pairs[1][1] > 0.0) & (pairs[0][1] > 0.0)
    assert np.any(both)  # where one stands before the other


def _name(key: str) -> str:
    return key.rsplit("/", 1)[0] + "/name"


def test_layers_in_acescg_are_the_same_light(written: tuple[Path, Floats, Floats]) -> None:
    """Against OpenColorIO's own conversion to ACEScg, and the composite rebuilt there."""
    ocio = pytest.importorskip("PyOpenColorIO")
    _, ground, expected = written
    body = placed(sphere(), (0.1, -0.5, -1.2))
    layer, variables = render_aovs(shot(body, width=64, medium=medium(), receiver=Receiver(plane_y=-1.2)))
    own, in_acescg = (exr_parts(layer, variables, ground, None, XY_BY_NAME[name]) for name in ("rec709", "ap1"))
    config = ocio.Config.CreateFromFile("ocio://studio-config-v2.1.0_aces-v1.3_ocio-v2.3")
    processor = config.getProcessor("Linear Rec.709 (sRGB)", "ACEScg").getDefaultCPUProcessor()

    def converted(light: Floats) -> Floats:
        pixels = np.ascontiguousarray(light, np.float32)
        processor.applyRGB(pixels)
        return pixels

    for name in ("diffuse", "veil", "receiver_difference"):
        found = in_acescg[name][name].astype(np.float32)
        np.testing.assert_allclose(found, converted(own[name][name]), atol=tol.HALF_FLOAT, err_msg=name)
    np.testing.assert_array_equal(in_acescg["transmittance"]["transmittance"], own["transmittance"]["transmittance"])
    rgba = in_acescg["rgba"]["RGBA"].astype(np.float32)
    difference = in_acescg["receiver_difference"]["receiver_difference"].astype(np.float32)
    rebuilt = rgba[..., :3] + (1.0 - rgba[..., 3:]) * (converted(ground) + difference)
    np.testing.assert_allclose(rebuilt, converted(expected), atol=tol.HALF_FLOAT)
