# SPDX-License-Identifier: Apache-2.0
"""Results as labelled arrays are the results of the calls, and a table keeps them, their units and their source."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import mr360uw as uw
from mr360uw.medium import LayeredField, LightField, Medium, Water
from mr360uw.video import VideoFrame
from mr360uw.video.writer import write_picture
from tests.scenes import gradient_plate, scene_with
from tests.tolerances import SPREAD

WATER = Water.jerlov("IB")


@pytest.fixture
def scene(tmp_path: Path) -> uw.Scene:
    (tmp_path / "card.obj").write_text("v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\nf 3 2 1\n")
    write_picture(tmp_path / "plate.png", VideoFrame.of_linear(gradient_plate(64, 32), 0, 0.0))
    return scene_with(tmp_path, tmp_path / "card.obj", rough=True)


def test_properties_of_a_water() -> None:
    made = uw.datasets.of_water(WATER, [450.0, 550.0])
    np.testing.assert_array_equal(made.c, made.a + made.b)
    np.testing.assert_array_equal(made.K_d.sel(wavelength_nm=550.0), WATER.diffuse_attenuation(550.0))
    assert (made.a.attrs["units"], made.attrs["source"]) == ("1/m", WATER.source)


def test_what_a_camera_sees_lies_where_its_axes_say() -> None:
    medium = Medium(WATER, mode="kd").scaled(2.0)
    made = uw.datasets.of_medium(medium, [0.0, 5.0], [3.0, 4.0, 6.0], [-0.5, 0.25])
    one = made.sel(distance_m=5.0, depth_m=4.0, up=-0.5)
    close = partial(np.testing.assert_allclose, rtol=1e-13)  # sums of many rays and of one are rounded differently
    close(one.transmittance, medium.transmittance(5.0, 4.0, -0.5))
    close(one.veil.sel(channel="green"), medium.veil(5.0, 4.0, -0.5)[1])
    close(made.irradiance.sel(depth_m=6.0), medium.irradiance(6.0))
    close(made.transmittance.sel(distance_m=0.0), 1.0)


def test_a_light_field_keeps_the_balance_of_its_energy() -> None:
    """d(E_d - E_u)/dz = -a E_0 (Gershun 1939)."""
    depth = np.array([4.999, 5.0, 5.001])
    made = uw.datasets.of_light_field(LightField([0.1, 0.2], [0.2, 0.1]), depth, [-1.0, 0.0, 1.0])
    net = (made.E_d - made.E_u).to_numpy()
    loss = -(net[2] - net[0]) / (depth[2] - depth[0])
    # rtol: second differences over 1 mm, 1e-7, and the quadrature of the streams
    np.testing.assert_allclose(loss, (made.a * made.E_0).sel(depth_m=5.0), rtol=1e-4)
    assert made.radiance.shape == (3, 3, 2)


def test_fields_know_their_wavelengths_and_layers() -> None:
    layers = LayeredField([0.0, 4.0], [[0.1, 0.2], [0.3, 0.4]], [[0.2, 0.1], [0.5, 0.5]])
    made = uw.datasets.of_light_field(layers, [1.0, 6.0], [-1.0, 1.0], [450.0, 550.0])
    np.testing.assert_array_equal(made.a.sel(top_m=4.0, wavelength_nm=550.0), 0.4)
    np.testing.assert_array_equal(made.E_d.sel(depth_m=6.0), layers.irradiance([6.0], 1.0)[0])
    assert made.radiance.dims == ("depth_m", "up", "wavelength_nm")
    with pytest.raises(uw.ParameterError, match="wavelength_nm - needs one for each"):
        uw.datasets.of_light_field(layers, [1.0], [1.0], [450.0])


def test_statistics_of_caustics() -> None:
    sea, settings = uw.caustics.GerstnerSea(wind_speed=3.0), uw.caustics.CausticSettings(size=64, grid=64)
    stack = uw.caustics.caustic_stack(sea, [0.0, 1.0, 0.0], [1.0, 4.0], 0.0, settings)
    made = uw.datasets.of_caustics(stack, sea, settings, time_s=0.0)
    assert made.contrast.dims == ("depth_m", "channel")
    assert [made.attrs[name] for name in ("wind_speed", "seed", "grid", "time_s")] == [3.0, sea.seed, 64, 0.0]
    np.testing.assert_allclose(made["mean"], 1.0, rtol=1e-5)  # float32
    assert np.all(made.skewness > 0.0)
    assert np.all(made.q01 < made.q50)
    assert np.all(made.q50 < made.q99)


def test_tables_come_back(tmp_path: Path) -> None:
    """Values bit for bit, axes in their order, units and what made them."""
    sea, settings = uw.caustics.GerstnerSea(wind_speed=3.0), uw.caustics.CausticSettings(size=16, grid=16)
    stack = uw.caustics.caustic_stack(sea, [0.0, 1.0, 0.0], [1.0, 4.0], 0.0, settings)
    made = {
        "water": uw.datasets.of_water(WATER, [450.0, 550.0]),
        "medium": uw.datasets.of_medium(Medium(WATER, mode="kd"), [3.0, 1.0], [3.0], [0.5, -0.5]),
        "field": uw.datasets.of_light_field(LightField([0.1, 0.2], [0.2, 0.1]), [1.0, 5.0], [-1.0, 1.0]),
        "caustics": uw.datasets.of_caustics(stack),
    }
    for name, dataset in made.items():
        uw.datasets.write_csv(dataset, tmp_path / f"{name}.csv")
        back = uw.datasets.read_csv(tmp_path / f"{name}.csv")
        for variable in dataset.data_vars:
            np.testing.assert_array_equal(back[variable], dataset[variable], strict=True)
            assert back[variable].dims == dataset[variable].dims
            assert back[variable].attrs == dataset[variable].attrs
        for axis in dataset.coords:
            np.testing.assert_array_equal(back[axis], dataset[axis])
        assert back.attrs["made_by"] == f"mr360uw {uw.__version__}"
        assert back.attrs.keys() == dataset.attrs.keys()
    (tmp_path / "other.csv").write_text("a,b\n1,2\n", "utf-8")
    with pytest.raises(uw.ParameterError, match="is no table"):
        uw.datasets.read_csv(tmp_path / "other.csv")


def test_the_spread_of_a_mean_is_that_of_its_frames() -> None:
    """The standard error of a mean, and the same draws for the same seed."""
    frames = list(np.random.default_rng(1).normal([1.0, 5.0], [0.1, 0.3], (200, 2)))
    found = uw.datasets.spread(lambda some: np.mean(some, axis=0), frames, draws=400)
    np.testing.assert_allclose(found["std"], np.std(frames, axis=0) / np.sqrt(200.0), rtol=SPREAD)
    np.testing.assert_array_equal(found.fit, np.mean(frames, axis=0))
    assert np.all((found.q05 < found.fit) & (found.fit < found.q95))
    again = uw.datasets.spread(lambda some: np.mean(some, axis=0), frames, draws=400)
    np.testing.assert_array_equal(again.q95, found.q95)
    with pytest.raises(uw.ParameterError, match="frames - must hold"):
        uw.datasets.spread(np.mean, [])


def test_a_table_keeps_figures_units_and_source(tmp_path: Path) -> None:
    made = uw.datasets.of_medium(Medium(WATER, mode="kd"), [1.0, 2.0], [3.0], [0.0])
    uw.datasets.write_csv(made, tmp_path / "veil.csv")
    table = pd.read_csv(tmp_path / "veil.csv", comment="#").set_index(["distance_m", "depth_m", "up", "channel"])
    np.testing.assert_array_equal(table.veil.to_xarray().sel(channel=made.channel), made.veil)
    text = (tmp_path / "veil.csv").read_text("utf-8")
    for fact in ("# veil [1/sr]", "# distance_m [m]", f"# made_by: mr360uw {uw.__version__}", "# mode: kd"):
        assert fact in text
    with pytest.raises(uw.OutputExistsError, match="already there"):
        uw.datasets.write_csv(made, tmp_path / "veil.csv")
    with pytest.raises(uw.ParameterError, match="water - must be a Water"):
        uw.datasets.of_water("IB", [500.0])  # type: ignore[arg-type]


def test_a_study_has_the_frames_of_its_variants(scene: uw.Scene) -> None:
    values = {"water.type": ["IB", "3C"], "camera.depth_m": [4.0, 9.0]}
    pictures = uw.sweep(scene, values, backend="reference")
    assert pictures.picture.dims == ("water.type", "camera.depth_m", "row", "column", "channel")
    alone = uw.sweep(scene.with_("water.type=3C"), {"camera.depth_m": [9.0]}, backend="reference")
    one = pictures.picture.sel({"water.type": "3C", "camera.depth_m": 9.0})
    np.testing.assert_array_equal(one, alone.picture[0])
    assert not np.array_equal(one, pictures.picture.sel({"water.type": "IB", "camera.depth_m": 9.0}))


def test_measures_of_a_study_have_names_and_axes(scene: uw.Scene) -> None:
    def measured(result: uw.FrameResult) -> dict[str, np.ndarray | float]:
        return {"mean": result.image_linear.mean(axis=(0, 1)), "covered": float(result.layer.alpha.mean())}

    study = uw.sweep(scene, {"object.0.scale": [0.5, 1.0]}, measured, backend="reference")
    assert study["mean"].dims == ("object.0.scale", "mean_0")
    assert 0.0 < study.covered[0] < study.covered[1]


def test_a_study_may_be_spread_over_workers(scene: uw.Scene) -> None:
    distributed = pytest.importorskip("distributed")
    values = {"camera.depth_m": [3.0, 5.0, 8.0]}
    with distributed.Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None) as client:
        spread = uw.sweep(scene, values, brightness, backend="reference", client=client)
    np.testing.assert_array_equal(spread.measure, uw.sweep(scene, values, brightness, backend="reference").measure)


def brightness(result: uw.FrameResult) -> float:
    return float(result.image_linear.mean())


def test_a_study_checks_all_of_its_values_first(scene: uw.Scene) -> None:
    with pytest.raises(uw.SceneError, match="depth_m"):
        uw.sweep(scene, {"camera.depth_m": [3.0, "deep"]}, pytest.fail)
    for none in ([], 3.0, "IB"):
        with pytest.raises(uw.ParameterError, match="values - needs a list"):
            uw.sweep(scene, {"camera.depth_m": none})
    with pytest.raises(uw.ParameterError, match="client - "):
        uw.sweep(scene, {"camera.depth_m": [3.0]}, client="tcp://farm:8786")
