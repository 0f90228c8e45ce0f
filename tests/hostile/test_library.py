# SPDX-License-Identifier: Apache-2.0
"""Public functions called with what is no number, not finite, empty, or of another shape: a typed error, or numbers."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mr360uw as uw
from mr360uw import caustics, ibl, medium, surface
from mr360uw.base import color, optics, sphere
from mr360uw.caustics import CausticSettings, GerstnerSea, SpectralSea
from mr360uw.errors import Mr360uwError
from mr360uw.medium import LightField, Medium, PlateProfile, Sensor, Water
from mr360uw.types import Sun, View
from tests.hostile.bench import Bench

UP = (0.0, 1.0, 0.0)
W = np.array([450.0, 550.0, 600.0, 650.0])
WATER = Water.jerlov("IB")
FIELD = LightField(np.full(4, 0.3), np.full(4, 0.3), "isotropic")
SEA = GerstnerSea(wave_count=4)
LEVEL = GerstnerSea(wind_speed=0.0)
SMALL = CausticSettings(size=16, grid=8)
SUN = Sun(np.array(UP), np.ones(3), 0.01, 1.0)
IMAGE = np.full((32, 64, 3), 0.3, np.float32)
BANDS = medium.bands(4)


def water_medium() -> Medium:
    return Medium(WATER, mode="kd", band_count=4)


MEDIUM = water_medium()
PROFILE = PlateProfile.from_map(np.exp(np.linspace(1.0, -1.0, 32))[:, None, None] * np.ones((32, 64, 3)))
ROW = np.full(9, 0.3)
CALLS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "direction_from_frame": (lambda **a: sphere.direction_from_frame(**a, width=64, height=32), {"x": ROW, "y": ROW}),
    "frame_from_direction": (lambda **a: sphere.frame_from_direction(**a, width=64, height=32), {"direction": UP}),
    "unit": (sphere.unit, {"vector": UP}),
    "luminance": (color.luminance, {"linear": IMAGE}),
    "decode": (lambda **a: color.decode(**a, transfer="srgb"), {"encoded": ROW}),
    "encode": (lambda **a: color.encode(**a, transfer="srgb"), {"linear": ROW}),
    "expand": (ibl.expand, {"plate_linear": IMAGE, "up": UP}),
    "environment": (ibl.environment, {"plate": IMAGE, "sun": UP, "up": UP}),
    "detect_sun": (ibl.detect_sun, {"plate": IMAGE}),
    "irradiance": (ibl.irradiance, {"radiance": IMAGE}),
    "irradiance, sh9": (lambda **a: ibl.irradiance(**a, method="sh9"), {"radiance": IMAGE}),
    "prefilter": (ibl.prefilter, {"radiance": IMAGE, "roughness": 0.5}),
    "glossy_beam": (ibl.glossy_beam, {"direction": UP, "irradiance": np.ones(3), "roughness": 0.5}),
    "split_sum": (ibl.split_sum, {"roughness": ROW, "n_dot_v": ROW}),
    "track_suns": (lambda **a: ibl.track_suns([SUN] * 3, **a), {"times_s": [0.0, 1.0, 2.0]}),
    "refract_to_air": (caustics.refract_to_air, {"direction_in_water": UP}),
    "refract_to_water": (caustics.refract_to_water, {"direction_in_air": UP}),
    "fresnel_reflectance": (caustics.fresnel_reflectance, {"cos_air": ROW}),
    "fresnel_transmittance": (caustics.fresnel_transmittance, {"cos_air": ROW, "refractive_index": 1.34}),
    "sea_water_index": (caustics.sea_water_index, {"wavelength_nm": W}),
    "stack_depths": (caustics.stack_depths, {"near_m": 2.0, "far_m": 5.0, "count": 4}),
    "caustic_map": (
        lambda **a: caustics.caustic_map(SEA, **a, size=16, grid=8),
        {"sun_direction_in_air": UP, "depth_m": 3.0, "time_s": 0.0},
    ),
    "caustic_stack": (
        lambda **a: caustics.caustic_stack(SEA, **a, settings=SMALL),
        {"sun_direction_in_air": UP, "depths_m": [2.0, 3.0], "time_s": 0.0},
    ),
    "GerstnerSea.surface": (SEA.surface, {"x_m": ROW, "z_m": ROW, "time_s": 0.0}),
    "SpectralSea.surface": (SpectralSea(resolution=16).surface, {"x_m": ROW, "z_m": ROW, "time_s": 0.0}),
    "GerstnerSea.from_waves": (
        GerstnerSea.from_waves,
        {"wave_vector": np.ones((3, 2)), "amplitude_m": 1e-3, "steepness": 0.5, "phase_rad": 0.0, "tile_m": 8.0},
    ),
    "Water.absorption": (WATER.absorption, {"wavelength_nm": W}),
    "Water.scattering": (WATER.scattering, {"wavelength_nm": W}),
    "Water.attenuation": (WATER.attenuation, {"wavelength_nm": W}),
    "Water.backscattering": (WATER.backscattering, {"wavelength_nm": W}),
    "Water.diffuse_attenuation": (WATER.diffuse_attenuation, {"wavelength_nm": W}),
    "Water.from_arrays": (
        Water.from_arrays, {"wavelength_nm": W, "absorption": np.full(4, 0.1), "scattering": np.full(4, 0.1)},
    ),
    "Water.chlorophyll": (Water.chlorophyll, {"mg_m3": 0.3}),
    "Sensor.from_arrays": (Sensor.from_arrays, {"wavelength_nm": W, "response": np.full((4, 3), 0.3)}),
    "Sensor.response": (Sensor.cie1931().response, {"wavelength_nm": W}),
    "illuminant": (medium.illuminant("D65"), {"wavelength_nm": W}),
    "LightField": (LightField, {"absorption": np.full(4, 0.3), "scattering": np.full(4, 0.3)}),
    "LightField.inscatter": (FIELD.inscatter, {"distance_m": ROW, "depth_m": 5.0, "up": 0.2}),
    "LightField.radiance": (FIELD.radiance, {"depth_m": 5.0, "up": ROW}),
    "LightField.irradiance": (FIELD.irradiance, {"depth_m": ROW, "normal_up": 0.3}),
    "LightField.scalar_irradiance": (FIELD.scalar_irradiance, {"depth_m": ROW}),
    "multiple_scattering": (
        lambda **a: medium.multiple_scattering(WATER, **a),
        {"wavelength_nm": W, "distance_m": 3.0, "depth_m": 5.0, "up": 0.2, "surface_irradiance": np.ones(4)},
    ),
    "Medium": (lambda **a: Medium(WATER, mode="kd", band_count=4, **a), {"camera_depth_m": 5.0}),
    "Medium.transmittance": (MEDIUM.transmittance, {"distance_m": ROW, "depth_m": 5.0, "up": 0.2}),
    "Medium.veil": (MEDIUM.veil, {"distance_m": ROW, "depth_m": 5.0, "up": 0.2}),
    "Medium.radiance": (MEDIUM.radiance, {"depth_m": 5.0, "up": ROW}),
    "Medium.irradiance": (MEDIUM.irradiance, {"depth_m": ROW, "normal_up": 0.3}),
    "Medium.scaled": (MEDIUM.scaled, {"gain": np.ones(3)}),
    "Bands.rgb": (BANDS.rgb, {"spectrum": np.ones(4)}),
    "Bands.log_light": (BANDS.log_light, {"log_spectrum": np.zeros(4)}),
    "reflectance": (medium.reflectance, {"albedo_rgb": np.full(3, 0.3), "wavelength_nm": W}),
    "fresnel_polarized": (optics.fresnel_polarized, {"cosine": ROW, "relative_index": 1.34}),
    "radiance_factor": (optics.radiance_factor, {"cosine": ROW, "relative_index": 1.34}),
    "Floor": (surface.Floor, {"height_m": -3.0, "albedo": np.full(3, 0.3), "tile_m": 1.0}),
    "picture": (
        lambda **a: surface.picture(LEVEL, floor=(-3.0, 0.3), view=View(4, 2, surface_y_m=1.0), samples=1, **a),
        {"dome": IMAGE, "time_s": 0.0, "refractive_index": 1.34},
    ),
    "compress_gamut": (medium.compress_gamut, {"rgb": np.full(3, 0.3)}),
    "PlateProfile.from_map": (PlateProfile.from_map, {"radiance_map": IMAGE}),
    "PlateProfile": (PROFILE, {"up": ROW}),
    "fit_gain": (lambda **a: medium.fit_gain(MEDIUM, **a), {"radiance_map": IMAGE}),
    "fit_water": (medium.fit_water, {"radiance_map": IMAGE, "camera_depth_m": 5.0}),
    "exposure_change": (medium.exposure_change, {"before": IMAGE, "after": IMAGE}),
    "picture_change": (medium.picture_change, {"before": IMAGE, "after": IMAGE}),
}  # fmt: skip
BAD: dict[str, Any] = {
    "text": "many", "texts": ["a", "b", "c"], "None": None, "objects": np.array([object()] * 3),
    "ragged": [[1.0], [1.0, 2.0]], "complex": np.full(3, 1j), "dates": np.zeros(3, "M8[s]"), "a table": {"x": 1.0},
    "nothing": [], "no rows": np.zeros((0, 3)), "nan": float("nan"), "infinity": float("inf"),
}  # fmt: skip
"""What stands in place of an array; the last two fill one of its own shape."""


def arrays(value: Any) -> Iterator[np.ndarray]:
    """Yield the arrays of floats in a result."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from arrays(getattr(value, field.name))
    elif isinstance(value, tuple | list):
        for item in value:
            yield from arrays(item)
    elif isinstance(value, np.ndarray | np.floating | float) and np.asarray(value).dtype.kind == "f":
        yield np.asarray(value)


def spoiled(value: Any, kind: str) -> Any:
    """Return what stands in place of an argument."""
    if kind not in ("nan", "infinity"):
        return BAD[kind]
    bad = np.array(value, np.float64)
    bad[(0,) * bad.ndim] = BAD[kind]
    return bad.astype(np.asarray(value).dtype) if np.ndim(value) else float(bad)


def check_an_error_or_numbers(call: Callable[..., Any], arguments: dict[str, Any], kind: str) -> None:
    told = ""
    try:
        with warnings.catch_warnings(action="error"):
            result = call(**arguments)
    except Mr360uwError as error:
        told = str(error)
    if told:
        assert told.count(" - ") >= 2  # where - what - what to do
    else:
        assert kind in ("nothing", "no rows", "infinity", "None"), result
        assert all(np.all(np.isfinite(array)) for array in arrays(result))


@pytest.mark.parametrize("name", CALLS)
def test_arguments(name: str, subtests: pytest.Subtests) -> None:
    call, good = CALLS[name]
    for argument in good:
        for kind in BAD:
            if kind == "None" and argument in ("sun", "up"):
                continue  # by default
            if name == "reflectance" and kind in ("nothing", "no rows"):
                continue  # is computed, for which colour-science must be imported: seconds
            with subtests.test(argument, kind=kind):
                check_an_error_or_numbers(call, {**good, argument: spoiled(good[argument], kind)}, kind)


def test_the_good_arguments_are_good() -> None:
    for name, (call, good) in CALLS.items():
        if name not in ("reflectance", "fit_water"):  # these take seconds, and have tests of their own
            call(**good)


def test_plates(bench: Bench, subtests: pytest.Subtests) -> None:
    scene = uw.load_scene(bench.folder / "scene.toml")
    plates = BAD | {
        "nan": np.full((32, 64, 3), np.nan, np.float32), "infinity": np.full((32, 64, 3), np.inf, np.float32),
        "codes": np.zeros((32, 64, 3), np.uint8), "grey": np.zeros((32, 64)), "square": np.zeros((64, 64, 3)),
        "clear": np.zeros((32, 64, 4)), "odd": np.zeros((31, 62, 3)),
    }  # fmt: skip
    for kind, plate in plates.items():
        with subtests.test(kind), pytest.raises(Mr360uwError, match="plate - "):
            uw.render_frame(plate, scene, backend="reference")


@pytest.mark.parametrize("frames", [(3, 1), (-1, 2), (0, 0), ("a", 3), (0.5, 2), (0, "b"), (0, 2.5), (None, 2)])
def test_ranges(frames: Any, bench: Bench) -> None:
    scene = uw.load_scene(bench.folder / "scene.toml")
    with pytest.raises(Mr360uwError, match=" - "):
        uw.composite_video(scene, bench.folder / "out_%d.png", frames=frames, backend="reference")
    assert not list(bench.folder.glob("out*"))


@pytest.mark.parametrize("backend", ["cuda", "", None, 7])
def test_backends(backend: Any, bench: Bench) -> None:
    scene = uw.load_scene(bench.folder / "scene.toml")
    with pytest.raises(Mr360uwError, match="backend"):
        uw.render_frame(IMAGE, scene, backend=backend)


@pytest.mark.parametrize(
    "made",
    [
        lambda: GerstnerSea(wind_speed=-1.0), lambda: GerstnerSea(tile_m=float("nan")), lambda: GerstnerSea(waves=3),
        lambda: GerstnerSea(seed=True), lambda: SpectralSea(spectrum="pink"), lambda: SpectralSea(resolution=3.5),
        lambda: CausticSettings(size=100), lambda: ibl.LightSettings(sun="moon"),
        lambda: medium.WaterSettings(type="mud"), lambda: uw.composite.ObjectSettings(scale=0.0),
        lambda: uw.video.EncodeSettings(quality=99),
    ],
)  # fmt: skip
def test_settings(made: Callable[[], Any]) -> None:
    with pytest.raises(Mr360uwError, match=r" - .* \(got .*\) - "):
        made()


@pytest.mark.parametrize(
    "channels", [np.zeros(3), np.zeros((2, 2, 2, 2)), np.zeros((4, 4, 3), object), np.zeros((0, 4, 3)), {}]
)
def test_exr_pictures_that_cannot_be_written(channels: Any, bench: Bench) -> None:
    with pytest.raises(Mr360uwError, match=" - "):
        uw.video.write_exr(bench.folder / "out.exr", channels)
    assert not (bench.folder / "out.exr").exists()


WRONG: tuple[Any, ...] = (None, "x", -1.0, float("nan"), [1, 2], {}, np.zeros((3, 3)), object())
SCENE = uw.Scene.model_validate({"plate": {"path": "plate.png"}})
TAKING: dict[str, Callable[[Any], Any]] = {
    "environment": ibl.environment, "expand": ibl.expand, "detect_sun": ibl.detect_sun,
    "sun of an environment": lambda x: ibl.environment(IMAGE, sun=x), "refract_to_air": caustics.refract_to_air,
    "wind": lambda x: GerstnerSea(wind_speed=x), "tile": lambda x: GerstnerSea(tile_m=x),
    "seed": lambda x: GerstnerSea(seed=x), "waves": lambda x: GerstnerSea.from_waves(x, [0.1], [0.5], [0.0]),
    "spectrum": lambda x: SpectralSea(spectrum=x), "place on a sea": lambda x: SEA.surface(x, 0.0, 0.0),
    "sea of caustics": lambda x: caustics.caustic_map(x, UP, 3.0, 0.0),
    "sun of caustics": lambda x: caustics.caustic_map(SEA, x, 3.0, 0.0, size=16, grid=8),
    "depth of caustics": lambda x: caustics.caustic_map(SEA, UP, x, 0.0, size=16, grid=8),
    "size of caustics": lambda x: caustics.caustic_map(SEA, UP, 3.0, 0.0, size=x, grid=8),
    "jerlov": Water.jerlov, "chlorophyll": Water.chlorophyll, "water of a file": Water.from_csv,
    "water of arrays": lambda x: Water.from_arrays(x, [0.1, 0.2], [0.1, 0.2]), "absorption": WATER.absorption,
    "camera": Sensor.camera, "bands": medium.bands, "sensor of bands": lambda x: medium.bands(4, x),
    "multiple_scattering": lambda x: medium.multiple_scattering(WATER, x, 1.0, 1.0, 0.0),
    "field": lambda x: LightField(x, [0.1]), "phase": lambda x: LightField([0.1], [0.1], phase=x),
    "water": Medium, "sensor": lambda x: Medium(WATER, x), "mode": lambda x: Medium(WATER, mode=x),
    "depth": lambda x: Medium(WATER, camera_depth_m=x), "scene file": uw.load_scene, "video": uw.open_video,
    "plate": lambda x: uw.render_frame(x, SCENE), "scene of a compositor": uw.Compositor,
    "scene of a video": lambda x: uw.composite_video(x, "out.mp4"), "clip": lambda x: uw.analyse_clip(x, SCENE),
    "clip of a track": uw.track_camera,
    "settings of a dive": lambda x: uw.sample_dive("nowhere", 0 if x is None else x),
}  # fmt: skip


def _refusal(call: Callable[[Any], Any], value: Any) -> str | None:
    """Return what a call says that refuses a value in the project's own words, None where it takes it."""
    try:
        call(value)
    except Mr360uwError as error:
        return str(error)
    return None


@pytest.mark.parametrize("name", TAKING)
def test_arguments_of_any_type_are_taken_or_refused_by_name(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    refused = {repr(value): _refusal(TAKING[name], value) for value in WRONG}
    assert [value for value, said in refused.items() if said is not None and " - " not in said] == []
    assert not list(tmp_path.iterdir())
