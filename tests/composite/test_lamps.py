# SPDX-License-Identifier: Apache-2.0
"""Lamps against closed forms, the renderers against each other, and lamps in scenes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mr360uw.base.color import luminance
from mr360uw.base.constants import BRIGHTEST
from mr360uw.base.sphere import directions, unit
from mr360uw.composite import render_layer
from mr360uw.composite.light_sources import Blockers, light_sources
from mr360uw.composite.mesh.material import Material
from mr360uw.composite.settings import LampSettings
from mr360uw.composite.shot import Receiver, Shot, black_body, lamp_attenuation, lamp_color, load_lamps
from mr360uw.composite.tiles import over
from mr360uw.errors import SceneError
from mr360uw.medium import Medium, Water
from mr360uw.medium.lookup import linear, table_coordinate
from mr360uw.medium.spectra import illuminant
from mr360uw.types import Floats, Lamp, Layer, View
from tests.composite import tolerances as tol
from tests.composite.scenes import box, codes, environment, medium, placed, plate, quad, shot, sphere
from tests.scenes import scene_with

ABSORPTION = np.array([0.35, 0.06, 0.04])
WATER = medium(absorption=tuple(ABSORPTION))
DARK = environment(0.0)
FADING = np.broadcast_to(ABSORPTION, (len(WATER.beam), 3)).copy()
INTENSITY = np.array([2.0, 1.5, 1.0])
Render = Callable[[Shot], Layer]


def point_lamp(position: tuple[float, ...], radius_m: float = 0.0, **more: Any) -> Lamp:
    return Lamp(np.array(position), np.array([0.0, 0.0, -1.0]), INTENSITY, radius_m=radius_m, **more)


def spot_lamp(position: tuple[float, ...], axis: tuple[float, ...], **more: Any) -> Lamp:
    return Lamp(np.array(position), unit(axis), INTENSITY, np.cos(0.35), np.cos(0.6), **more)


@pytest.fixture(params=["reference", "gl"])
def render(request: pytest.FixtureRequest) -> Render:
    if request.param == "reference":
        return render_layer
    request.getfixturevalue("gl")
    from mr360uw.composite.gl.layer_renderer import LayerRenderer

    return LayerRenderer().render


def shown(render: Render, scene: Shot) -> Floats:
    """Return the radiance (H, W, 3) of fully covered pixels, NaN elsewhere."""
    layer = render(scene)
    return np.where(layer.alpha[..., None] > 0.999, layer.radiance, np.nan)


@pytest.mark.parametrize("water", [None, WATER], ids=["air", "water"])
def test_a_wall_in_homogeneous_water(render: Render, water: Any) -> None:
    """L = albedo/pi I cos/r^2 exp(-c (r + S)), plus the veil that the wall has in the dark."""
    lamp = point_lamp((0.5, 0.4, -0.7), attenuation=None if water is None else FADING)
    matt = Material(base_color=(0.5, 0.5, 0.5, 1.0), roughness=1.0, refractive_index=1.0 if water is None else 1.34)
    wall = placed(quad(matt, size=3.0), (0.0, 0.0, -2.0))
    scene = shot(wall, width=128, environment=DARK, sun=None, medium=water, lamps=(lamp,))
    got = shown(render, scene) - shown(render, replace(scene, lights=()))
    d = directions(128, 64)
    with np.errstate(divide="ignore"):
        point = d * (-2.0 / d[..., 2:3])
    away = lamp.position - point
    r, s = np.linalg.norm(away, axis=-1), np.linalg.norm(point, axis=-1)
    lost = np.exp(-(r + s)[..., None] * (0.0 if water is None else ABSORPTION))
    expected = 0.5 / np.pi * INTENSITY * (away[..., 2] / r**3)[..., None] * lost
    inside = np.isfinite(got[..., 0])
    assert inside.sum() > 500
    np.testing.assert_allclose(got[inside], expected[inside], rtol=tol.LAMP_WALL)


def test_the_ground_under_a_lamp(render: Render) -> None:
    """ratio = 1 + I cos/r^2 exp(-c (r + S)) / (E_plate exp(-c S)) on a plane, in a plate lit from all sides alike."""
    sky = environment(0.2)
    lamp = point_lamp((0.3, 0.2, -1.5), attenuation=FADING)
    floor = Receiver(plane_y=-1.0, extent_m=50.0)
    scene = shot(width=128, environment=sky, sun=None, medium=WATER, lamps=(lamp,), receiver=floor)
    ratio = render(scene).ratio
    d = directions(128, 64)
    rows = slice(48, 64)  # the ground within 1.4 m
    point = (d * (-1.0 / d[..., 1:2]))[rows]
    away = lamp.position - point
    r = np.linalg.norm(away, axis=-1)[..., None]
    plate_light = 0.2 * np.pi * np.exp(-ABSORPTION)  # a metre below the camera
    expected = 1.0 + INTENSITY * away[..., 1:2] / r**3 * np.exp(-ABSORPTION * r) / plate_light
    np.testing.assert_allclose(ratio[rows], expected, rtol=tol.LAMP_GROUND)


def test_lamps_of_no_power_change_no_bit(render: Render) -> None:
    bodies = placed(sphere(), (0.4, -0.6, -1.8)), placed(box((0.6, 0.5, 0.4)), (-0.6, -0.95, -1.6), (25, 0, 0))
    scene = shot(*bodies, width=128, medium=WATER, receiver=Receiver(plane_y=-1.2))
    off = replace(point_lamp((0.0, 0.5, -1.0), attenuation=FADING), intensity=np.zeros(3))
    plain, with_lamp = render(scene), render(replace(scene, lights=(*scene.lights, off)))
    for name in ("radiance", "alpha", "distance_m", "ratio"):
        assert np.array_equal(getattr(plain, name), getattr(with_lamp, name)), name


def test_a_spot_is_dark_beyond_its_edge() -> None:
    lamp = spot_lamp((0.0, 0.0, 0.0), (0.0, 0.0, -1.0))
    (source,) = light_sources(shot(sun=None, lamps=(lamp,)))
    angle = np.array([0.0, 0.3, 0.35, 0.6, 0.7, np.pi])
    point = 2.0 * np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=-1)
    irradiance = source.arrival(point)[1] / INTENSITY * 4.0
    np.testing.assert_allclose(irradiance[:, 0], [1.0, 1.0, 1.0, 0.0, 0.0, 0.0], atol=tol.FLOAT64)
    assert np.all(source.arrival(point[2:4].mean(axis=0, keepdims=True))[1] > 0.0)


def test_half_of_a_ball_shows_over_a_straight_edge() -> None:
    """The edge of a wide sheet goes through the middle of the lamp as seen from the place: half of the disc."""
    sheet = placed(quad(size=4.0), (2.0, 0.0, -1.0))  # covers x > 0 at z = -1
    scene = shot(sheet, sun=None, lamps=(point_lamp((0.0, 0.0, 0.0), 0.1),), sun_samples=32)
    (source,) = light_sources(scene, Blockers(scene))
    places = np.array([[0.0, 0.0, -2.0], [0.5, 0.0, -2.0], [-0.5, 0.0, -2.0], [0.0, 0.0, -0.5]])
    np.testing.assert_allclose(source.visibility(places), [0.5, 0.0, 1.0, 1.0], atol=tol.LAMP_HALF)


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("name", ["spot", "point", "among bodies", "air", "many bodies"])
def test_renderers_agree(name: str) -> None:
    from mr360uw.composite.gl.layer_renderer import LayerRenderer

    bodies = [placed(sphere(), (0.4, -0.6, -1.8)), placed(box((0.6, 0.5, 0.4)), (-0.6, -0.95, -1.6), (25, 0, 0))]
    if name == "many bodies":
        ball = sphere(8, radius=0.12)
        bodies = [placed(ball, (0.4 * (k % 5) - 0.8, -0.9 + 0.3 * (k // 10), -1.4 - 0.2 * (k // 5))) for k in range(20)]
    water = None if name == "air" else WATER
    fading = None if water is None else FADING
    lamps = {
        "spot": (spot_lamp((0.6, 0.9, -0.6), (-0.5, -1.0, -1.0), radius_m=0.05, attenuation=fading),),
        "point": (point_lamp((-0.2, 0.2, -1.0), 0.02, attenuation=fading),),
        "among bodies": (point_lamp((0.0, -0.9, -2.4), attenuation=fading), point_lamp((0.1, 0.8, -1.5), 0.1)),
        "air": (spot_lamp((0.6, 0.9, -0.6), (-0.5, -1.0, -1.0), radius_m=0.05),),
        "many bodies": (point_lamp((0.0, 0.0, -1.0), 0.02, attenuation=fading),),
    }[name]
    lamps = tuple(replace(lamp, intensity=0.3 * lamp.intensity, attenuation=fading) for lamp in lamps)
    scene = shot(
        *bodies, width=256, environment=environment(0.05), medium=water, lamps=lamps,
        receiver=Receiver(plane_y=-1.2, extent_m=8.0), sun=None,
    )  # fmt: skip
    ground = 0.4 * plate(256)
    a = codes(over(ground, LayerRenderer().render(scene)))  # whose form factors need not wait for the reference's
    b = codes(over(ground, render_layer(scene)))
    difference = np.abs(a - b)
    assert np.abs(b - codes(ground)).max() > 30.0
    assert 20.0 * np.log10(255.0 / np.sqrt(np.mean(difference**2))) > tol.RENDERERS_PSNR_DB
    assert np.mean(difference.max(axis=-1) <= tol.RENDERERS_CODES) >= tol.RENDERERS_FRACTION


def test_a_dark_plate_is_multiplied_by_a_bounded_factor() -> None:
    lamp = point_lamp((0.0, -0.5, -1.0))
    floor = Receiver(plane_y=-1.0)
    layer = render_layer(shot(width=64, environment=DARK, sun=None, lamps=(lamp,), receiver=floor))
    assert layer.ratio.max() == pytest.approx(1.0 + BRIGHTEST, rel=tol.FLOAT32)


# --- photometry and spectra -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [LampSettings(lumen=900.0, cone_deg=360.0), LampSettings(lumen=900.0, cone_deg=50.0),
     LampSettings(lumen=900.0, cone_deg=120.0)],
)  # fmt: skip
def test_all_of_the_flux_comes_out(settings: LampSettings) -> None:
    """The integral of the luminous intensity over the sphere is the flux over the plate's white."""
    (made,) = load_lamps((settings,), None, 500.0)
    lamp = made.at(0.0, View(8, 4), ())
    (source,) = light_sources(shot(sun=None, lamps=(lamp,)))
    cosine = np.linspace(-1.0, 1.0, 200001)
    point = np.stack([np.sqrt(1.0 - cosine**2), 0.0 * cosine, -cosine], axis=-1)
    total = 2.0 * np.pi * np.trapezoid(luminance(source.arrival(point)[1]), cosine)
    assert total == pytest.approx(900.0 / 500.0, rel=tol.LAMP_FLUX)


@pytest.mark.parametrize("kelvin", [2700.0, 5600.0, 10000.0])
def test_water_takes_a_lamps_own_spectrum(kelvin: float) -> None:
    """The table against the sum over the bands, along the whole path there and back."""
    water = Medium(Water.jerlov("II"), camera_depth_m=8.0)
    path = np.geomspace(0.05, 60.0, 40)
    spectrum = black_body(water.bands.wavelength_nm, kelvin) / illuminant("D65")(water.bands.wavelength_nm)
    direct = water.bands.rgb(spectrum * np.exp(-water.model.extinction * path[:, None]))
    table = lamp_attenuation(water, kelvin)
    assert table.shape == water.table.beam.shape
    lost = linear(table, table_coordinate(path, water.length_m)) * path[:, None]
    np.testing.assert_allclose(np.exp(-lost) * water.bands.rgb(spectrum), direct, rtol=tol.LAMP_WALL)
    color = lamp_color(water, kelvin)
    assert luminance(color) == pytest.approx(1.0)
    assert (color[0] > color[2]) == (kelvin < 6500.0)


# --- in scenes ------------------------------------------------------------------------------------------------------


def test_lamps_follow_what_they_are_fixed_to() -> None:
    body = placed(sphere(), (1.0, 0.0, -2.0), (90.0, 0.0, 0.0))
    view = View(8, 4, np.array([0.0, 1.0, 0.0]))
    keys = ({"time_s": 0.0}, {"time_s": 2.0, "position_m": (0.0, 0.0, -4.0)})
    on_body, on_camera, keyed = load_lamps(
        (
            LampSettings(attach=0, position_m=(0.0, 0.0, -0.5)),
            LampSettings(attach="camera", position_m=(0.2, 0.0, 0.0), rotation_deg=(0.0, -90.0, 0.0)),
            LampSettings(key=keys, interpolation="linear"),
        ),
        None,
        1.0,
    )
    lamp = on_body.at(0.0, view, (body,))
    np.testing.assert_allclose(lamp.position, [1.5, 0.0, -2.0], atol=tol.FLOAT64)  # nose to the right
    np.testing.assert_allclose(lamp.axis, [1.0, 0.0, 0.0], atol=tol.FLOAT64)
    lamp = on_camera.at(0.0, view, ())
    np.testing.assert_allclose(lamp.position, [0.2, 1.0, 0.0], atol=tol.FLOAT64)
    np.testing.assert_allclose(lamp.axis, [0.0, -1.0, 0.0], atol=tol.FLOAT64)
    np.testing.assert_allclose(keyed.at(1.0, view, ()).position, [0.0, 0.0, -2.0], atol=tol.FLOAT64)
    assert on_body.moves
    assert on_camera.moves
    assert keyed.moves


@pytest.mark.parametrize(
    ("lamp", "says"),
    [
        ({"attach": 1}, "no such object (got 1)"),
        ({"key": [{"time_s": 1.0}, {"time_s": 1.0}]}, "must be later"),
        ({"color": [1.0, -0.1, 0.0]}, "must be three numbers >= 0"),
        ({"cone_deg": 0.0}, "cone_deg"),
        ({"temperature_k": 10.0}, "temperature_k"),
        ({"lumens": 10.0}, "did you mean 'lumen'"),
    ],
)
def test_bad_lamps_are_said(tmp_path: Path, whale: Path, lamp: dict[str, Any], says: str) -> None:
    with pytest.raises(SceneError) as caught:
        scene_with(tmp_path, whale, lamp=[lamp])
    assert len(caught.value.problems) == 1
    assert says in str(caught.value)
