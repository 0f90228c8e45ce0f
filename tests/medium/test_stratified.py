# SPDX-License-Identifier: Apache-2.0
"""Waters of a paper: coefficients that change with depth, and phase functions of one's own."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from mr360uw.errors import ParameterError
from mr360uw.medium import LambertFloor, LayeredField, LightField, PhaseTable, Water
from mr360uw.medium.phase import backscatter_ratio, henyey_greenstein, phase_function, phase_moments
from mr360uw.medium.ray_field import Sky
from mr360uw.scene.model import files_of, load_scene
from mr360uw.video import write_exr
from tests.medium.tolerances import (
    DRIVEN_APART,
    FLOAT64,
    HG_BY_ANGLES,
    LAYERS_OF_PROFILE,
    NET_FLUX,
    TABLE_OF_PETZOLD,
    WINDOW_BY_STREAMS,
)

DEPTH = np.array([0.0, 0.5, 3.0, 8.0, 20.0])
SUN: Sky = ("sun", 0.8, 0.7)


@pytest.mark.parametrize("floor", [None, LambertFloor(15.0, (0.4,))])
@pytest.mark.parametrize("sky", ["uniform", SUN])
def test_equal_layers_are_homogeneous_water(sky: Sky, floor: LambertFloor | None) -> None:
    a, b = np.array([0.1, 0.3]), np.array([0.2, 0.5])
    whole = LightField(a, b, "petzold", sky=sky, floor=floor)
    layers = LayeredField([0.0, 2.0, 7.0], np.tile(a, (3, 1)), np.tile(b, (3, 1)), "petzold", sky=sky, floor=floor)
    for normal in (-1.0, 0.3, 1.0):
        np.testing.assert_allclose(layers.irradiance(DEPTH, normal), whole.irradiance(DEPTH, normal), rtol=DRIVEN_APART)
    np.testing.assert_allclose(layers.scalar_irradiance(DEPTH), whole.scalar_irradiance(DEPTH), rtol=DRIVEN_APART)


def test_a_beam_without_scattering_follows_beer_and_lambert() -> None:
    top, a = [0.0, 2.0, 5.0], np.array([0.1, 0.4, 0.2])
    field = LayeredField(top, a, np.zeros(3), sky=("sun", 0.8, 1.0))
    optical_depth = np.interp(DEPTH, [0.0, 2.0, 5.0, 20.0], [0.0, 0.2, 1.4, 4.4])
    np.testing.assert_allclose(field.irradiance(DEPTH)[:, 0], np.exp(-optical_depth / 0.8), rtol=FLOAT64)
    np.testing.assert_allclose(field.diffuse_attenuation(DEPTH)[:, 0], a[[0, 0, 1, 2, 2]] / 0.8, rtol=FLOAT64)
    np.testing.assert_allclose(field.transmittance(5.0, 1.0, -0.8)[0], np.exp(-(0.1 + 3 * 0.4) / 0.8), rtol=FLOAT64)
    np.testing.assert_allclose(field.transmittance(5.0, 3.0, 0.0)[0], np.exp(-2.0), rtol=FLOAT64)
    np.testing.assert_allclose(field.transmittance(50.0, 1.0, 0.5)[0], np.exp(-0.1 / 0.5), rtol=FLOAT64)


def test_what_layers_absorb_is_lost_and_their_light_is_continuous() -> None:
    """d(E_d - E_u)/dz = -a E_0 (Gershun 1939) within each layer."""
    a = np.array([0.1, 0.4, 0.2])
    field = LayeredField([0.0, 2.0, 7.0], a, [0.3, 0.05, 0.6], sky=SUN, floor=LambertFloor(12.0, (0.3,)))
    depth, step = np.array([1.0, 4.0, 9.0]), 1e-4

    def net(y: np.ndarray) -> np.ndarray:
        return field.irradiance(y, 1.0)[:, 0] - field.irradiance(y, -1.0)[:, 0]

    lost = (net(depth - step) - net(depth + step)) / (2.0 * step)
    np.testing.assert_allclose(lost, a * field.scalar_irradiance(depth)[:, 0], rtol=NET_FLUX)
    for edge in (2.0, 7.0):
        above, below = np.nextafter(edge, 0.0), edge
        for normal in (-1.0, 1.0):
            np.testing.assert_allclose(field.irradiance(above, normal), field.irradiance(below, normal), rtol=1e-9)
    np.testing.assert_allclose(field.irradiance(12.0, -1.0), 0.3 * field.irradiance(12.0, 1.0), rtol=1e-9)


@pytest.mark.parametrize("floor", [None, LambertFloor(15.0, (0.3, 0.4))])
@pytest.mark.parametrize("sky", ["uniform", SUN])
def test_equal_layers_scatter_into_rays_what_homogeneous_water_does(sky: Sky, floor: LambertFloor | None) -> None:
    a, b = np.array([0.05, 0.2]), np.array([0.1, 0.3])
    whole = LightField(a, b, "petzold", sky=sky, floor=floor)
    layers = LayeredField([0.0, 3.0, 7.0], np.tile(a, (3, 1)), np.tile(b, (3, 1)), "petzold", sky=sky, floor=floor)
    random = np.random.default_rng(1)
    depth, up = random.uniform(0.0, 12.0, 100), np.append(random.uniform(-1.0, 1.0, 98), [0.0, 0.0])
    distance = random.uniform(0.0, 40.0, 100)
    if floor is not None:  # beyond it a `LightField` goes on
        distance = np.where(up < 0.0, np.minimum(distance, (15.0 - depth) / np.maximum(-up, 1e-9)), distance)
    for found, expected in (
        (layers.inscatter(distance, depth, up), whole.inscatter(distance, depth, up)),
        (layers.radiance(depth, up), whole.radiance(depth, up)),
    ):
        np.testing.assert_allclose(found, expected, rtol=DRIVEN_APART)


def test_the_radiance_of_layers_adds_up_to_their_irradiance() -> None:
    """Rays that are traced through the layers know nothing of the irradiances, which the modes give at once."""
    field = LayeredField(
        [0.0, 3.0, 7.0], [0.05, 0.3, 0.05], [0.1, 0.5, 0.2], "isotropic", floor=LambertFloor(15.0, (0.3,))
    )
    x, weight = np.polynomial.legendre.leggauss(100)
    middle = float(np.sqrt(1.0 - 1.0 / 1.34**2))  # the edge of Snell's window
    up = np.concatenate([0.5 * (x + 1.0) * middle, middle + 0.5 * (x + 1.0) * (1.0 - middle)])
    weight = 2.0 * np.pi * up * np.concatenate([0.5 * weight * middle, 0.5 * weight * (1.0 - middle)])
    for depth in (0.0, 2.0, 5.0, 9.0):
        for side in (1.0, -1.0):
            total = weight @ field.radiance(depth, side * up)
            np.testing.assert_allclose(total, field.irradiance(depth, side), rtol=WINDOW_BY_STREAMS)


def test_a_ray_through_layers_is_its_parts() -> None:
    field = LayeredField([0.0, 2.0, 7.0], [0.1, 0.4, 0.2], [0.3, 0.05, 0.6], "isotropic", sky=SUN)
    for up in (-0.6, 0.0, 0.3):
        near, whole = field.inscatter([3.0, 9.0], 6.0, up)
        far = field.inscatter(6.0, 6.0 - 3.0 * up, up)
        np.testing.assert_allclose(whole, near + field.transmittance(3.0, 6.0, up) * far, rtol=1e-9)


def test_a_profile_converges_with_its_layers(tmp_path: Path) -> None:
    depth, a, b = [0.0, 10.0], [0.05, 0.3], [0.1, 0.4]
    found = [LayeredField.from_profile(depth, a, b, layers=n).irradiance(6.0)[0] for n in (5, 10, 40)]
    errors = np.abs(np.array(found[:2]) - found[2])
    assert errors[1] < LAYERS_OF_PROFILE * errors[0]
    rows = ["depth_m,wavelength_nm,absorption,scattering", "10,500,0.3,0.4", "10,450,0.2,0.4", "0,450,0.02,0.1",
            "0,500,0.05,0.1"]  # fmt: skip
    (tmp_path / "profile.csv").write_text("\n".join(rows), "utf-8")
    table = LayeredField.from_csv(tmp_path / "profile.csv", layers=5)
    np.testing.assert_allclose(table.irradiance(6.0)[1], found[0], rtol=FLOAT64)
    (tmp_path / "profile.csv").write_text("\n".join(rows[:-1]), "utf-8")
    with pytest.raises(ParameterError, match="every depth needs the same wavelengths"):
        LayeredField.from_csv(tmp_path / "profile.csv")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"top_m": [0.0, 0.0]}, "top_m - must ascend"),
        ({"top_m": [1.0, 2.0]}, "top_m - must ascend"),
        ({"absorption": [0.1]}, "absorption - must have the shape"),
        ({"absorption": [0.1, 0.0]}, "layers - absorption"),
        ({"scattering": [0.1, -1.0]}, "layers - absorption"),
        ({"surface": "rough"}, "surface - must be 'snell' or 'none'"),
        ({"refractive_index": 9.0}, "refractive_index"),
        ({"floor": LambertFloor(1.0, (0.3,))}, "floor - must lie below"),
        ({"floor": LambertFloor(9.0, (0.3, 0.2))}, "floor - needs one albedo"),
        ({"phase": "rough"}, "phase - unknown"),
    ],
)
def test_impossible_layers_are_refused(wrong: dict[str, object], message: str) -> None:
    given: dict[str, object] = {"top_m": [0.0, 2.0], "absorption": [0.1, 0.2], "scattering": [0.1, 0.2]}
    with pytest.raises(ParameterError, match=message):
        LayeredField(**given | wrong)  # type: ignore[arg-type]


def petzold_as_a_users() -> PhaseTable:
    table = resources.files("mr360uw.medium") / "data" / "petzold_average_particle.csv"
    with resources.as_file(table) as path:
        return PhaseTable.from_csv(path)


def test_a_tabulated_petzold_is_the_built_in() -> None:
    table, angle = petzold_as_a_users(), np.geomspace(1e-4, np.pi, 300)
    np.testing.assert_allclose(table(angle), phase_function("petzold", angle), rtol=TABLE_OF_PETZOLD)
    np.testing.assert_allclose(phase_moments(table, 65), phase_moments("petzold", 65), atol=TABLE_OF_PETZOLD)
    np.testing.assert_allclose(backscatter_ratio(table), backscatter_ratio("petzold"), rtol=TABLE_OF_PETZOLD)
    fields = [LightField([0.1], [0.3], phase, sky=SUN) for phase in (table, "petzold")]
    for up in (-1.0, 0.0, 0.9):
        found, expected = (field.radiance(DEPTH, up) for field in fields)
        np.testing.assert_allclose(found, expected, rtol=TABLE_OF_PETZOLD)


def test_a_water_of_a_table_goes_all_the_way_to_its_veil() -> None:
    waters = [Water.jerlov("IB", phase=phase) for phase in (petzold_as_a_users(), "petzold")]
    from mr360uw.medium import Medium

    found, expected = (Medium(water, band_count=4).veil([1.0, 9.0], 5.0, 0.1) for water in waters)
    np.testing.assert_allclose(found, expected, rtol=TABLE_OF_PETZOLD)


def test_moments_and_angles_of_one_function_agree() -> None:
    g, angle = 0.7, np.geomspace(1e-3, np.pi, 400)
    by_moments = PhaseTable.from_moments(g ** np.arange(80))
    by_angles = PhaseTable.from_angles(np.degrees(angle), 3.0 * henyey_greenstein(np.cos(angle), g))
    for table in (by_moments, by_angles):
        np.testing.assert_allclose(phase_moments(table, 60), g ** np.arange(60), atol=HG_BY_ANGLES)
        np.testing.assert_allclose(table(angle), henyey_greenstein(np.cos(angle), g), rtol=HG_BY_ANGLES)


def test_each_wavelength_may_have_a_phase_function() -> None:
    phases = ["petzold", ("hg", 0.8)]
    both = LightField([0.1, 0.1], [0.3, 0.3], phases, sky=SUN)  # type: ignore[arg-type]
    for number, phase in enumerate(phases):
        alone = LightField([0.1], [0.3], phase, sky=SUN)  # type: ignore[arg-type]
        np.testing.assert_allclose(
            both.irradiance(DEPTH, 1.0)[:, number], alone.irradiance(DEPTH, 1.0)[:, 0], rtol=1e-9
        )


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PhaseTable.from_angles([10.0, 5.0], [1.0, 1.0]), "angles or more that ascend"),
        (lambda: PhaseTable.from_angles([0.0, 5.0], [1.0, 1.0]), "must lie in"),
        (lambda: PhaseTable.from_angles([1.0, 5.0], [1.0, 0.0]), "must lie in"),
        (lambda: PhaseTable.from_angles([1.0, 5.0], [1.0]), "angle_deg - must have the shape"),
        (lambda: PhaseTable.from_moments([2.0, 0.1]), "must begin with 1"),
        (lambda: PhaseTable.from_moments([1.0, 0.99]), "negative phase function"),
        (lambda: PhaseTable.from_moments(["a"]), "moment - must be real numbers"),
        (PhaseTable, "two angles or more"),
    ],
)  # fmt: skip
def test_what_is_no_phase_function_is_refused(make: object, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        make()  # type: ignore[operator]


def test_a_scene_names_a_table_of_a_phase_function(tmp_path: Path) -> None:
    angle = np.geomspace(1e-3, np.pi, 400)
    value = henyey_greenstein(np.cos(angle), 0.7)
    rows = "".join(f"{a:.17g},{v:.17g}\n" for a, v in zip(np.degrees(angle), value, strict=True))
    (tmp_path / "particles.csv").write_text("angle_deg,phase_function\n" + rows, "utf-8")
    (tmp_path / "scene.toml").write_text('[plate]\npath = "dive.exr"\n[water]\nphase = "particles.csv"\n', "utf-8")
    write_exr(tmp_path / "dive.exr", np.zeros((32, 64, 3), np.float32))
    scene = load_scene(tmp_path / "scene.toml")
    water, named = scene.water.water(), Water.jerlov("IB").with_phase(("hg", 0.7))
    assert water is not None
    assert tmp_path / "particles.csv" in files_of(scene)
    np.testing.assert_allclose(water.moments([450.0, 650.0], 12), named.moments([450.0, 650.0], 12), atol=HG_BY_ANGLES)
