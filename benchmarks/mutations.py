# SPDX-License-Identifier: Apache-2.0
"""Whether the tests find faults: single lines are changed, one at a time, and the tests around them must fail.

    python benchmarks/mutations.py               # all faults, about twenty minutes
    python benchmarks/mutations.py snow optics   # those of files whose path has one of these words

Each fault is put into a copy of the tree, where the test files run that are given beside it, then those that name its
module, up to the first that fails. A fault that no test finds is printed as MISSED; the exit code is their number.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
MOST_FILES = 7
"""Test files that are run for a fault at the most, those named beside it first."""
FAULTS: tuple[tuple[str, str, str, str], ...] = (
    # path below the package, what stands there, what it becomes, test files beside those that name the module
    ("cache.py", "array.dtype.str, array.shape, array.tobytes()", "array.dtype.str, array.shape", "test_cache.py"),
    ("caustic_lookup.py", "levels.append(0.25 * (rows", "levels.append(0.5 * (rows", "caustics/test_caustics.py"),
    ("caustic_lookup.py", "u, v = (x + stack.sun_direction[0] * up)", "u, v = (x - stack.sun_direction[0] * up)",
     "agreement/test_lookups.py"),
    ("color.py", "((a + 0.055) / 1.055) ** 2.4", "((a + 0.055) / 1.055) ** 2.2", "test_color.py"),
    ("color.py", "a <= 0.04045 / 12.92", "a <= 0.04045", "test_color.py"),
    ("files.py", "return _size(found) <= _size(marks) and", "return", "test_files.py"),
    ("files.py", "found.st_mode & _OTHERS_WRITE and not", "not", "test_disk_cache.py"),
    ("optics.py", "1.0 / (n * c_i + c_t) ** 2", "1.0 / (n * c_i - c_t) ** 2",
     "caustics/test_refraction.py surface/test_optics.py"),
    ("optics.py", "(1.0 - fresnel(cosine, relative_index)) *", "fresnel(cosine, relative_index) *",
     "caustics/test_refraction.py surface/test_optics.py"),
    ("optics.py", "[..., None] / c)", "[..., None])", "surface/test_picture.py"),
    ("optics.py", "- 4382.0 / w**2", "- 4832.0 / w**2", "caustics/test_refraction.py surface/test_optics.py"),
    ("output_gate.py", "lock.acquire(timeout=0)", "None", "runs/test_resuming.py"),
    ("sphere.py", "np.multiply(-cos_latitude", "np.multiply(cos_latitude", "test_sphere.py"),
    ("sphere.py", "edge[:-1] - edge[1:]", "edge[1:] - edge[:-1]", "test_sphere.py"),
    ("sphere.py", "+ 4.0 * np.square(spread_rad)", "+ 2.0 * np.square(spread_rad)",
     "composite/test_shading.py test_sphere.py composite/test_gl.py"),
    ("texels.py", "t * t * (3.0 - 2.0 * t)", "t * t * (2.0 - t)", "composite/test_receiver.py"),
    ("tile_blend.py", "haze = min(veil, below)", "haze = veil", "composite/test_over.py"),
    ("bench/bench_report.py", "SLOWER * was.cpu_ms and m.cpu_ms - was.cpu_ms > _LEAST_MS", "SLOWER * was.cpu_ms",
     "bench/test_bench.py"),
    ("bench/bench_report.py", "error > WORSE * before and error - before > _TINY_ERROR", "error < WORSE * before",
     "bench/test_bench.py"),
    ("bench/bench_report.py", "(cheaper and not worse) or (better and not dearer)", "cheaper or better",
     "bench/test_bench.py"),
    ("caustics/deposit.py", "2.0 * (flux_b + flux_d) / d", "2.0 * flux_d / d", "caustics/test_caustics.py"),
    ("caustics/export.py", "grid * sample(splines[1], rest_x, rest_z)", "grid * sample(splines[1], rest_z, rest_x)",
     "caustics/test_export.py"),
    ("caustics/gerstner.py", "self.phase_rad - self.angular_frequency * time_s",
     "self.phase_rad + self.angular_frequency * time_s", ""),
    ("caustics/gerstner.py", "sideways = self.steepness * amplitude", "sideways = amplitude", ""),
    ("caustics/gerstner.py", "strain * dx * dx, strain * dz * dz", "strain * dz * dz, strain * dx * dx",
     "caustics/test_seas.py"),
    ("caustics/irradiance.py", "refract_clamped(-sun_in_air, normal, 1.0 / refractive_index)",
     "refract_clamped(-sun_in_air, normal, refractive_index)", ""),
    ("caustics/spectral.py", "2.0 * float(np.sum(np.abs(h0) ** 2))", "float(np.sum(np.abs(h0) ** 2))",
     "caustics/test_seas.py"),
    ("caustics/spectral.py", "(h0[::-1, ::-1], (1, 1)", "(h0[::-1, ::-1], (0, 0)", "caustics/test_seas.py"),
    ("caustics/spectral.py", "* group_speed(k, sea.water_depth_m) / k", "* group_speed(k, sea.water_depth_m)",
     "caustics/test_seas.py"),
    ("caustics/spectral.py", "1j * kx * kz * shift", "1j * kx * kx * shift", "caustics/test_seas.py"),
    ("caustics/sun_disc.py", "(refractive_index * water[1])", "water[1]", "caustics/test_caustics.py"),
    ("caustics/sun_disc.py", "along * sun_in_air[1] / water[1] ** 2", "along * sun_in_air[1] / water[1]",
     "caustics/test_caustics.py"),
    ("caustics/sun_disc.py", "bend = 1.0 - float(", "bend = float(", "caustics/test_detail_blur.py"),
    ("caustics/sun_disc.py", "(1.0 / up - 1.0) * np.outer", "(up - 1.0) * np.outer", "caustics/test_soft_light.py"),
    ("composite/aovs.py", "(share[:, None] * values[name])", "values[name]", "composite/test_exr_layers.py"),
    ("composite/at_surface/surface_layer.py", "light if sides.in_water else light / square", "light",
     "composite/test_at_surface.py"),
    ("composite/at_surface/surface_layer.py", "through * images.alpha", "images.alpha", "composite/test_at_surface.py"),
    ("composite/at_surface/surface_layer.py", "(bent, 1.0 - reflected, shows[1], False)",
     "(bent, reflected, shows[1], False)", "composite/test_at_surface.py"),
    ("composite/at_surface/surface_rays.py", "refract_clamped(self.direction, against, 1.0 / relative_index)",
     "refract_clamped(self.direction, against, relative_index)", "composite/test_at_surface.py"),
    ("composite/at_surface/water_sides.py", "return 1.0 / self.refractive_index if", "return self.refractive_index if",
     "composite/test_at_surface.py"),
    ("composite/at_surface/water_sides.py", "(n * n * np.maximum(passed", "(n * np.maximum(passed",
     "composite/test_at_surface.py"),
    ("composite/gl/light_visibility.py", "np.tan(radius), *slope", "np.tan(0.5 * radius), *slope",
     "composite/test_light_visibility.py"),
    ("composite/gl/object_pass.py", "bias = visibility.bias *", "bias = -visibility.bias *",
     "composite/test_scale.py composite/test_lamps.py composite/test_gl.py"),
    ("composite/gl/shaders/layer.frag", "parts.sun * (1.0 - 1.0 / max(waves, 1e-6))", "parts.sun",
     "composite/test_gl.py agreement composite/test_exr_layers.py"),
    ("composite/grading/colour_grade.py", "(3.0 - 2.0 * k) * (u - inside)", "k * (u - inside)",
     "composite/test_colour_grade.py"),
    ("composite/grading/colour_grade.py", "1.0 / self.saturation, weights)", "self.saturation, weights)",
     "composite/test_colour_grade.py"),
    ("composite/grading/colour_grade.py", "np.sinh(np.arcsinh(inner) / 3.0)", "np.sinh(np.arcsinh(inner) / 2.0)",
     "composite/test_colour_grade.py"),
    ("composite/grading/patch_solve.py", "own + self._grown * self._light_of_water(grade)",
     "own - self._grown * self._light_of_water(grade)", "render/test_patches_in_water.py"),
    ("composite/grading/settings.py", "1.0 if self.columns is None else columns / self.columns",
     "1.0 if self.columns is None else self.columns / columns", "composite/test_grading.py"),
    ("composite/grading/settings.py", "if white - black < LEAST_STEP", "if black - white < LEAST_STEP",
     "composite/test_colour_grade.py"),
    ("composite/grading/softness.py", "(soft - _blurred(soft, grade.sharpening_px))",
     "(_blurred(soft, grade.sharpening_px) - soft)", "composite/test_grading.py"),
    ("composite/grading/softness.py", "np.sqrt(variance - OWN_VARIANCE)", "variance - OWN_VARIANCE",
     "composite/test_grading.py"),
    ("composite/lighting/light_sources.py", "towards) / distance**2)", "towards) / distance)",
     "composite/test_lamps.py"),
    ("composite/lighting/light_sources.py", "path = distance + back", "path = distance", "composite/test_lamps.py"),
    ("composite/lighting/light_sources.py", "return 1.0 + (ratio - 1.0) * contrast", "return ratio * contrast",
     "composite/test_gl.py"),
    ("composite/lighting/shading.py", "return np.square((index - medium_index) / (index + medium_index))",
     "return np.square((index - 1.0) / (index + 1.0))", ""),
    ("composite/lighting/shading.py", "return squared * INV_PI / (d * d)", "return squared * INV_PI / d", ""),
    ("composite/lighting/shading.py", "0.5 / np.maximum(v + s, 1e-6)", "0.25 / np.maximum(v + s, 1e-6)",
     "agreement/test_twins.py"),
    ("composite/lighting/shading.py", "np.maximum(f0, 0.0) / 0.04, 0.2)", "np.maximum(f0, 0.0) / 0.04, 0.3)",
     "agreement/test_twins.py"),
    ("composite/lighting/shadow.py", "(seen[fine] + again) / (_ROUNDS * count)", "again / (_ROUNDS * count)",
     "composite/test_reference.py"),
    ("composite/lighting/shadow.py", "passed: Floats = np.asarray(~self._opaque",
     "passed: Floats = np.asarray(self._opaque", "composite/test_lamps.py"),
    ("composite/mesh/ply_stl.py", "triangles[1::2] = triangles[1::2, ::-1]", "triangles[0::2] = triangles[0::2, ::-1]",
     "composite/test_meshes_as_found.py"),
    ("composite/mesh/ply_stl.py", "uv * [1.0, -1.0] + [0.0, 1.0]", "uv", "composite/test_mesh_formats.py"),
    ("composite/mesh/skin.py", "after, cosine = -after, -cosine", "after, cosine = after, -cosine",
     "composite/test_animation.py"),
    ("composite/mesh/skin.py", "world[parent] @ local[number]", "local[number] @ world[parent]",
     "composite/test_animation.py"),
    ("composite/mesh/skin.py", "span * self.tangents[key, 1]", "self.tangents[key, 1]", "composite/test_animation.py"),
    ("composite/motion.py", "\"+x\": -90.0, \"-x\": 90.0", "\"+x\": 90.0, \"-x\": -90.0", "composite/test_placing.py"),
    ("composite/motion.py", "self.position, np.log(self.scale))", "self.position, self.scale)",
     "composite/test_motion.py"),
    ("composite/motion.py", "math.atan2(-place[0], place[2])", "math.atan2(place[0], -place[2])",
     "composite/test_placing.py"),
    ("composite/over.py", "kept -= np.clip(shot.holdout[tile.window]", "kept *= np.clip(shot.holdout[tile.window]",
     "composite/test_over.py"),
    ("composite/playback.py", "time_s % duration_s\n", "min(time_s, duration_s)\n", "composite/test_animation.py"),
    ("composite/playback.py", "duration_s - abs(time_s % (2.0 * duration_s) - duration_s)",
     "abs(time_s % (2.0 * duration_s) - duration_s)", "composite/test_animation.py"),
    ("composite/raycast.py", "mesh.material + len(materials)", "mesh.material", "composite/test_translucent.py"),
    ("composite/receiver/blocks.py", "enlarged(quarters), 0.0)", "enlarged(quarters), 0.5)",
     "composite/test_receiver.py"),
    ("composite/receiver/pattern.py", "np.log(sigma) / np.log(_STEP)", "np.log(sigma) / np.log(4.0)",
     "composite/test_pattern.py"),
    ("composite/receiver/pattern.py", "base = calm - veil", "base = calm", "composite/test_pattern.py"),
    ("composite/receiver/ratio.py", "share * free + (r - share)", "free + (r - share)", "composite/test_receiver.py"),
    ("composite/receiver/ratio.py", "weight = 1.0 - smoothstep(", "weight = smoothstep(", "composite/test_receiver.py"),
    ("composite/receiver/shape.py", "-np.sign(self.level_m)", "np.sign(self.level_m)", "composite/test_receiver.py"),
    ("composite/shafts.py", "change = np.minimum(change, 0.0)", "change = np.maximum(change, 0.0)",
     "render/test_shafts_drawn.py"),
    ("composite/shot.py", "float(np.max(self.mesh.extent_m)) * self.scale", "float(np.max(self.mesh.extent_m))",
     "composite/test_scale.py"),
    ("composite/snow/draw.py", "np.sum(direction * towards, axis=-1)", "np.sum(-direction * towards, axis=-1)", ""),
    ("composite/snow/particles.py", "(low_m, high_m, -exponent)", "(low_m, high_m, 1.0 - exponent)", ""),
    ("composite/snow/particles.py", "_integral(SMALLEST_M, LARGEST_M, 2.0 - exponent)",
     "_integral(SMALLEST_M, LARGEST_M, 3.0 - exponent)", "composite/test_snow.py"),
    ("composite/tiles.py", "math.asin(ratio) / (2.0 * math.pi)", "math.asin(ratio) / (8.0 * math.pi)",
     "composite/test_eyes.py"),
    ("depth/clip_eyes.py", "far = half / np.tan(0.5 * pixel", "far = half / np.tan(pixel", "depth/test_eye_stereo.py"),
    ("depth/clip_eyes.py", "for own, other, sign in ((left, right, 1.0), (right, left, -1.0)):",
     "for own, other, sign in ((left, right, 1.0), (right, left, 1.0)):", "depth/test_eye_stereo.py"),
    ("depth/clip_eyes.py", "np.mod(np.arange(width) - sign * shift", "np.mod(np.arange(width) + sign * shift",
     "depth/test_eye_stereo.py"),
    ("depth/clip_water.py", "up = away[..., 1] / distance", "up = away[..., 2] / distance", "depth/test_clip_water.py"),
    ("depth/depth_files.py", "metres if kind == \"metric\" else np.float32(1.0) / metres",
     "metres if kind == \"inverse\" else np.float32(1.0) / metres", "depth/test_plate_maps.py"),
    ("depth/sphere_stereo.py", "0.5 * (before - after) / np.maximum", "0.5 * (after - before) / np.maximum",
     "depth/test_sphere_stereo.py"),
    ("depth/warping.py", "reference.rotation.T @ (one.position - reference.position)",
     "(one.position - reference.position)", "depth/test_sphere_stereo.py"),
    ("depth/warping.py", "[one.rotation.T @ reference.rotation for", "[reference.rotation.T @ one.rotation for",
     "depth/test_sphere_stereo.py"),
    ("first_look/observations.py", "\"+\" if thicker > 0.0 else \"-\"", "\"-\" if thicker > 0.0 else \"+\"",
     "first_look/test_looks.py"),
    ("first_look/observations.py", "low <= size <= high]", "low <= size]", "first_look/test_looks.py"),
    ("first_look/place_in_plate.py", "_EDGES * (np.sqrt", "-_EDGES * (np.sqrt", "first_look/test_places.py"),
    ("first_look/place_in_plate.py", "z = right * np.sin(azimuth) - ahead * np.cos(azimuth)",
     "z = right * np.sin(azimuth) + ahead * np.cos(azimuth)", "first_look/test_places.py"),
    ("from_above/aerial_bodies.py", "beam / np.maximum(whole, 1e-30) * (hidden", "beam * (hidden",
     "from_above/test_aerial_bodies.py"),
    ("from_above/aerial_bodies.py", "distance[:, None] * d + wet[:, None] * bent", "(distance + wet)[:, None] * d",
     "from_above/test_aerial_picture.py"),
    ("from_above/aerial_picture.py", "turned @ tilt, 0.0", "tilt @ turned, 0.0", "from_above/test_aerial_picture.py"),
    ("ibl/filters.py", "(scale - 1 - half) % width", "(scale - half) % width", "ibl/test_integrals.py"),
    ("ibl/plate.py", "x - 0.5).astype(np.float32), np.clip(y - 0.5", "x).astype(np.float32), np.clip(y",
     "ibl/test_integrals.py"),
    ("ibl/plate.py", "(gain - 1.0) * weight", "gain * weight", "ibl/test_expansion.py"),
    ("ibl/plate.py", "edge - _RAMP, edge + _RAMP", "edge + _RAMP, edge - _RAMP", "ibl/test_expansion.py"),
    ("ibl/settings.py", "centre - 0.00569 -", "centre + 0.569 -", ""),
    ("ibl/settings.py", "10.3 / (degrees + 5.11)", "10.3 / (degrees + 51.1)", ""),
    ("ibl/sun/blob.py", "0.1063 * red + 0.3576 * green + 0.0361 * blue",
     "0.2126 * red + 0.7152 * green + 0.0722 * blue", "ibl/test_sun.py"),
    ("ibl/sun/judge.py", "_falling(confidence, 1.5 * _HALF_TAKEN, 0.5 * _HALF_TAKEN)",
     "_falling(confidence, 0.5 * _HALF_TAKEN, 1.5 * _HALF_TAKEN)", "ibl/test_sun.py"),
    ("ibl/sun/split.py", "residual - coarse), sun)", "residual), sun)", "ibl/test_sun.py"),
    ("ibl/sun/split.py", "irradiance - area @ change", "irradiance + area @ change", "ibl/test_glare.py"),
    ("ibl/sun/split.py", "weight = amount * clear *", "weight = amount *", "ibl/test_glare.py"),
    ("ibl/sun/split.py", "(elevation_sine(coarse_directions(), up), 0.0)",
     "(-elevation_sine(coarse_directions(), up), 0.0)", "ibl/test_closure.py"),
    ("ibl/sun/split.py", " * coarse_solid_angle()[row]).sum", ").sum", "ibl/test_sun.py"),
    ("ibl/sun/steady.py", "0, last - first)]", "0, None)]", "ibl/test_steady.py"),
    ("ibl/sun/steady.py", "(samples, 1.0) / (2.0 * math.pi))", "(samples, 1.0))", "ibl/test_steady.py"),
    ("ibl/sun/steady.py", "trust = w / (1.0 + square", "trust = w * (1.0 + square", "ibl/test_steady.py"),
    ("ibl/sun/steady.py", "_turns(times_s, direction, weight, middle, path):", "True:", "ibl/test_steady.py"),
    ("ibl/sun/steady.py", "direction[order, 1]))", "direction[order, 0]))", "ibl/test_steady.py"),
    ("match/caustic_match.py", "(plate.azimuth_deg - second[2])", "(plate.azimuth_deg + 90.0)",
     "match/test_caustic_match.py"),
    ("match/floor_series.py", "np.arctan2(self.direction[0], -self.direction[1])",
     "np.arctan2(self.direction[0], self.direction[1])", "match/test_caustic_match.py"),
    ("match/floor_series.py", "travel = -np.stack([", "travel = np.stack([", "match/test_caustic_match.py"),
    ("match/floor_series.py", "np.sqrt(GRAVITY_M_S2 * 2.0 * np.pi / self.wavelength_m)",
     "np.sqrt(GRAVITY_M_S2 / self.wavelength_m)", "match/test_caustic_match.py"),
    ("medium/closed_form.py", "q = (c - k * mu) * s", "q = (c + k * mu) * s", ""),
    ("medium/closed_form.py", "(wanted - clear - own_a) / wide * shape", "(wanted - clear - own_a) * shape",
     "medium/test_water.py"),
    ("medium/closed_form.py", "one(nm) ** (1.0 - share) * other(nm) ** share",
     "one(nm) ** share * other(nm) ** (1.0 - share)", "medium/test_water.py"),
    ("medium/layers.py", "self.scattering * (1.0 - peak)", "self.scattering * peak", "medium/test_stratified.py"),
    ("medium/layers.py", "np.lexsort((columns[\"wavelength_nm\"], columns[\"depth_m\"]))",
     "np.argsort(columns[\"depth_m\"])[::-1]", "medium/test_stratified.py"),
    ("medium/layers.py", "(kept - left) * self.radiance", "(kept + left) * self.radiance", "medium/test_stratified.py"),
    ("medium/lookup.py", "2.0 / (VEIL_SIZE[1] - 1)), 0.0)", "0.0), 0.0)", "medium/test_medium.py"),
    ("medium/models.py", "return kd * (1.0 - reflectance) / a", "return kd * (1.0 + reflectance) / a",
     "medium/test_closed_form.py"),
    ("medium/models.py", "share = window_share(ray[-1]", "share = window_share(-ray[-1]", ""),
    ("medium/phase.py", "2.0 * g * (1.0 - cos_theta)", "2.0 * g * (1.0 + cos_theta)", ""),
    ("medium/phase.py", "3.0 * (1.0 - 2.0 * s2) ** 2 - 1.0", "3.0 * (1.0 - 2.0 * s2) ** 2 + 1.0", ""),
    ("medium/ray_field.py", "small = abs(lost) < _LEAST", "small = abs(lost) < 50.0 * _LEAST", ""),
    ("medium/ray_field.py", "reflectance * rising)", "rising)", ""),
    ("medium/scattered_light.py", "b = gap[before], (azimuth - AZIMUTHS[before])",
     "b = gap[before], (AZIMUTHS[before] - azimuth)", "medium/test_around_sun.py"),
    ("medium/shafts/occluders.py", "(along > 0.0) & (along * along >= outside)",
     "(along < 0.0) & (along * along >= outside)", "medium/test_shafts.py"),
    ("medium/shafts/shaft_scene.py", "whole[:, :, kind] * (soft - 1.0)", "whole[:, :, kind] * soft",
     "medium/test_shafts.py"),
    ("medium/shafts/shaft_scene.py", "(edge[:, :-1] < hit) & (hit < edge[:, 1:])",
     "(edge[:, :-1] < hit) | (hit < edge[:, 1:])", "medium/test_shafts.py"),
    ("medium/shafts/single_scattering.py", "pattern.sharp(point, along).reshape(len(part), steps, 3) - 1.0",
     "pattern.sharp(point, along).reshape(len(part), steps, 3)", "medium/test_single_scattering.py"),
    ("medium/spectra.py", "curves(wavelength_nm) @ self.matrix.T", "curves(wavelength_nm) @ self.matrix",
     "medium/test_bands.py"),
    ("medium/waterfit.py", "np.exp(-0.5 * (value - lowest))", "np.exp(0.5 * (value - lowest))", "medium/test_plate.py"),
    ("preview/pages.py", "float(live.plates.reader(scene).frame_rate) + 1e-6)",
     "float(live.plates.reader(scene).frame_rate)) + 1", "preview/test_still.py"),
    ("published/__init__.py", "1.0 + (peak - 1.0) * np.square(", "1.0 + peak * np.square(", "ibl/test_expansion.py"),
    ("published/__init__.py", "np.array([1.0, 2 / 3, 2 / 3, 2 / 3, 0.25,", "np.array([1.0, 1.0, 1.0, 1.0, 0.25,",
     "ibl/test_integrals.py"),
    ("published/__init__.py", "albedo * own + color * (1.0 - own)", "albedo * own + color * own",
     "from_above/test_aerial_picture.py"),
    ("render/caustic_depths.py", "ground = surface - max(levels_y), surface - min(levels_y)",
     "ground = surface - min(levels_y), surface - max(levels_y)", "render/test_caustic_depths.py"),
    ("render/lights.py", "below / _GREATEST_ALBEDO - shown", "below * _GREATEST_ALBEDO - shown",
     "render/test_clipped_light.py"),
    ("render/plan.py", "deep = beam < _NEGLIGIBLE_BEAM", "deep = beam > _NEGLIGIBLE_BEAM", "render/test_plan.py"),
    ("render/plan.py", "left > FAINTEST", "left < FAINTEST", "render/test_surface_stage.py"),
    ("runs/work_folder.py", "[str(file.path), file.size, file.digest, file.changed_ns]", "[str(file.path), file.size]",
     "runs/test_fingerprint.py"),
    ("sample/whale_shape.py", "np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])", "faces[:, [0, 1]]",
     "sample/test_whale.py"),
    ("sample/whale_shape.py", "a, b, c, a, c, d], axis=-1", "a, c, b, a, d, c], axis=-1", "sample/test_whale.py"),
    ("scene/key_targets.py", "time_s, side=\"right\")) - 1", "time_s, side=\"left\")) - 1", "scene/test_keys.py"),
    ("scene/key_targets.py", "if turns:\n        values = np.unwrap", "if not turns:\n        values = np.unwrap",
     "scene/test_keys.py"),
    ("scene/key_targets.py", "if after <= one:", "if after < one:", "scene/test_keys.py"),
    ("scene/key_targets.py", "np.clip(np.max(key.value)", "np.clip(np.min(key.value)", "caustics/test_keyed_sea.py"),
    ("scene/model.py", "if key not in table.model_fields_set", "", "scene/test_quality.py"),
    ("scene/model.py", "{**values, **table}", "{**table, **values}", "scene/test_quality.py"),
    ("scene/resolved.py", "math.log(value) / math.log(_RATIO)", "math.log(value)", "render/test_keyed_water.py"),
    ("scene/resolved.py", "along = self._gone(time_s) / self._length * self.steps",
     "along = (time_s - self.start) / (self.stop - self.start) * self.steps", "render/test_keyed_water.py"),
    ("surface/sampled_sea.py", "by_x @ kx**2, k @ gone @ kx, by_z @ k**2", "by_z @ k**2, k @ gone @ kx, by_x @ kx**2",
     "surface/test_intersection.py"),
    ("surface/sampled_sea.py", "slope[:, 1:-1] *= 2.0", "slope[:, 1:-1] *= 1.0", "surface/test_intersection.py"),
    ("surface/sampled_sea.py", "0.5 * sea.blur_slope**2", "sea.blur_slope**2", "surface/test_picture.py"),
    ("surface/sky.py", "np.einsum(\"hwc,hw->c\", self._upper, self._weights * passed)",
     "np.einsum(\"hwc,hw->c\", self._upper, self._weights)", "surface/test_picture.py"),
    ("surface/water_light.py", "floor_m + depth_m, floor_m, 0.0", "floor_m, floor_m, 0.0", "surface/test_picture.py"),
    ("track/camera_track.py", "float(n @ camera) - h", "-h", "track/test_floor.py"),
    ("track/camera_track.py", "scale = -float(a @ (depth", "scale = float(a @ (depth", "track/test_scale.py"),
    ("track/camera_track.py", "found[1:] * found[:-1], axis=1) < 0.0", "found[1:] * found[:-1], axis=1) > 0.0",
     "track/test_camera_files.py"),
    ("track/key_poses.py", "shift = -across", "shift = across", "track/test_resection.py"),
    ("track/path_files.py", "-np.einsum(\"nij,nj->ni\", to_world, values[:, 4:])",
     "-np.einsum(\"nij,nj->ni\", from_world, values[:, 4:])", "track/test_camera_files.py"),
    ("track/path_files.py", "from_euler(\"zxy\", values[:, [6, 4, 5]]", "from_euler(\"ZXY\", values[:, [6, 4, 5]]",
     "track/test_camera_files.py"),
    ("track/path_files.py", "frame = 1.0 + np.round(", "frame = np.round(", "track/test_camera_files.py"),
    ("track/path_files.py", "track.rotation)[:, [3, 0, 1, 2]]", "track.rotation)", "track/test_camera_files.py"),
    ("track/path_files.py", "if len(twice):", "if len(twice) > 1:", "track/test_camera_files.py"),
    ("tune/click_tools.py", "float(camera.position[1]) - height, 0.0", "-height, 0.0", "tune/test_placing.py"),
    ("tune/lasso.py", "(1.0 - share) * self._distance[0] + share * self._distance[1]",
     "share * self._distance[0] + (1.0 - share) * self._distance[1]", "tune/test_matte_keys.py"),
    ("tune/lasso.py", "np.roll(whole, -turn, axis=1)", "np.roll(whole, turn, axis=1)", "tune/test_lasso.py"),
    ("tune/placing.py", "np.arctan2(towards[0], -towards[2])", "np.arctan2(-towards[0], -towards[2])",
     "tune/test_placing.py"),
    ("tune/placing.py", "np.tan(last) / np.tan(first)", "last / first", "tune/test_placing.py"),
    ("tune/placing.py", "low[1], 0.5 * (low[2] + high[2])", "high[1], 0.5 * (low[2] + high[2])",
     "tune/test_placing.py"),
    ("tune/placing.py", "yaw_deg - 90.0 * moved / arm", "yaw_deg + 90.0 * moved / arm", "tune/test_placing.py"),
    ("video/layout.py", "(eye == \"left\") == (stereo not in LEFT_FIRST)",
     "(eye == \"left\") == (stereo in LEFT_FIRST)", "test_stereo.py"),
    ("video/layout.py", "found[number, part] = -shift", "found[number, part] = shift", "video/test_eyes_seen.py"),
    ("video/layout.py", "height = EYES_APART_M / slope", "height = slope / EYES_APART_M", "video/test_eyes_seen.py"),
    ("video/pixels/grain.py", "- twice + block[r, c + lag]", "+ twice + block[r, c + lag]", "video/test_grain.py"),
    ("video/pixels/kernels.py", "+ np.float32(0.5)", "+ np.float32(0.0)", "video/test_grain.py video/test_planes.py"),
    ("video/spherical.py", "offsets >= old_end, size - old_size", "offsets >= old_end, old_size - size",
     "video/test_spherical.py"),
    ("video/spherical.py", "(round(angle * 65536.0)", "(round(angle * 65535.0 / 360.0)", "video/test_spherical.py"),
    ("yuv/cube_lut.py", ".transpose(2, 1, 0, 3)", "", "video/test_luts.py"),
    ("yuv/cube_lut.py", "for stage in reversed(self.stages)", "for stage in self.stages", "video/test_luts.py"),
    ("yuv/cube_lut.py", "x / last * (self.high - self.low)", "x / last", "video/test_luts.py"),
    ("yuv/decoding.py", "-y_offset / y_span, c_offset", "y_offset / y_span, c_offset", "test_yuv.py"),
    ("yuv/decoding.py", "(0.25 if sy else 0.0)", "(0.75 if sy else 0.0)", "video/test_planes.py"),
    ("yuv/file_profile.py", "np.array(self.matrix).T)\n", "np.array(self.matrix))\n", "video/test_picture_files.py"),
)  # fmt: skip


def tests_of(path: str, beside: str) -> list[str]:
    """Return the test files of a module of the package: those given, and those that name it."""
    module = "mr360uw." + path.removesuffix(".py").replace("/", ".")
    found = [f"tests/{name}" for name in beside.split()]
    for file in sorted((ROOT / "tests").rglob("test_*.py")):
        text = file.read_text("utf-8")
        if f"from {module} import" in text or f"import {module}\n" in text:
            found.append(str(file.relative_to(ROOT)))
    parent, name = module.rsplit(".", 1)
    if len(found) < 2:
        for file in sorted((ROOT / "tests").rglob("test_*.py")):
            found += [str(file.relative_to(ROOT))] * (f"from {parent} import {name}" in file.read_text("utf-8"))
    return list(dict.fromkeys(found))[:MOST_FILES]


def first_failure(tests: list[str], folder: Path) -> str:
    """Return the first test that fails in a copy of the tree, "" if none does."""
    for file in tests:
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", file]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
        if done.returncode == 1 and failed:
            return failed[0].split(" - ")[0].removeprefix("FAILED ")
    return ""


def main(words: list[str]) -> int:
    """Try the faults; return how many were missed."""
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in ("mr360uw", "tests", "samples", "docs", "benchmarks"):
            shutil.copytree(ROOT / name, Path(folder, name), ignore=shutil.ignore_patterns("__pycache__"))
        for file in ("pyproject.toml", "README.md"):
            shutil.copy(ROOT / file, folder)
        for path, before, after, beside in FAULTS:
            if words and not any(word in path for word in words):
                continue
            changed = Path(folder, "mr360uw", path)
            text = changed.read_text("utf-8")
            if before not in text:
                sys.exit(f"{path}: {before!r} does not stand there")
            start, tests = time.perf_counter(), tests_of(path, beside)
            changed.write_text(text.replace(before, after, 1), "utf-8")
            by = first_failure(tests, Path(folder))
            changed.write_text(text, "utf-8")
            verdict = "found" if by else f"MISSED ({len(tests)} files)"
            missed += not by
            print(f"{time.perf_counter() - start:6.1f} s  {verdict:8s} {path}: {after[:60]!r}  {by}", flush=True)
    return missed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
