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
    ("optics.py", "1.0 / (n * c_i + c_t) ** 2", "1.0 / (n * c_i - c_t) ** 2",
     "caustics/test_refraction.py surface/test_optics.py"),
    ("optics.py", "(1.0 - fresnel(cosine, relative_index)) *", "fresnel(cosine, relative_index) *",
     "caustics/test_refraction.py surface/test_optics.py"),
    ("optics.py", "[..., None] / c)", "[..., None])", "surface/test_picture.py"),
    ("optics.py", "- 4382.0 / w**2", "- 4832.0 / w**2", "caustics/test_refraction.py surface/test_optics.py"),
    ("sphere.py", "np.multiply(-cos_latitude", "np.multiply(cos_latitude", "test_sphere.py"),
    ("sphere.py", "edge[:-1] - edge[1:]", "edge[1:] - edge[:-1]", "test_sphere.py"),
    ("sphere.py", "+ 4.0 * np.square(spread_rad)", "+ 2.0 * np.square(spread_rad)",
     "composite/test_shading.py test_sphere.py composite/test_gl.py"),
    ("color.py", "((a + 0.055) / 1.055) ** 2.4", "((a + 0.055) / 1.055) ** 2.2", "test_color.py"),
    ("color.py", "a <= 0.04045 / 12.92", "a <= 0.04045", "test_color.py"),
    ("medium/closed_form.py", "q = (c - k * mu) * s", "q = (c + k * mu) * s", ""),
    ("medium/models.py", "return kd * (1.0 - reflectance) / a", "return kd * (1.0 + reflectance) / a",
     "medium/test_closed_form.py"),
    ("medium/models.py", "share = window_share(ray[-1]", "share = window_share(-ray[-1]", ""),
    ("medium/phase.py", "2.0 * g * (1.0 - cos_theta)", "2.0 * g * (1.0 + cos_theta)", ""),
    ("medium/phase.py", "3.0 * (1.0 - 2.0 * s2) ** 2 - 1.0", "3.0 * (1.0 - 2.0 * s2) ** 2 + 1.0", ""),
    ("medium/ray_field.py", "small = abs(lost) < _LEAST", "small = abs(lost) < 50.0 * _LEAST", ""),
    ("medium/ray_field.py", "reflectance * rising)", "rising)", ""),
    ("medium/lookup.py", "2.0 / (VEIL_SIZE[1] - 1)), 0.0)", "0.0), 0.0)", "medium/test_medium.py"),
    ("medium/shafts/single_scattering.py", "pattern.sharp(point, along).reshape(len(part), steps, 3) - 1.0",
     "pattern.sharp(point, along).reshape(len(part), steps, 3)", "medium/test_single_scattering.py"),
    ("ibl/filters.py", "(scale - 1 - half) % width", "(scale - half) % width", "ibl/test_integrals.py"),
    ("ibl/settings.py", "centre - 0.00569 -", "centre + 0.569 -", ""),
    ("ibl/settings.py", "10.3 / (degrees + 5.11)", "10.3 / (degrees + 51.1)", ""),
    ("caustics/gerstner.py", "self.phase_rad - self.angular_frequency * time_s",
     "self.phase_rad + self.angular_frequency * time_s", ""),
    ("caustics/gerstner.py", "sideways = self.steepness * amplitude", "sideways = amplitude", ""),
    ("caustics/irradiance.py", "refract_clamped(-sun_in_air, normal, 1.0 / refractive_index)",
     "refract_clamped(-sun_in_air, normal, refractive_index)", ""),
    ("composite/shot.py", "float(np.max(self.mesh.extent_m)) * self.scale", "float(np.max(self.mesh.extent_m))",
     "composite/test_scale.py"),
    ("composite/lighting/shading.py", "return np.square((index - medium_index) / (index + medium_index))",
     "return np.square((index - 1.0) / (index + 1.0))", ""),
    ("composite/lighting/shading.py", "return squared * INV_PI / (d * d)", "return squared * INV_PI / d", ""),
    ("composite/lighting/shading.py", "0.5 / np.maximum(v + s, 1e-6)", "0.25 / np.maximum(v + s, 1e-6)",
     "agreement/test_twins.py"),
    ("composite/lighting/shading.py", "np.maximum(f0, 0.0) / 0.04, 0.2)", "np.maximum(f0, 0.0) / 0.04, 0.3)",
     "agreement/test_twins.py"),
    ("composite/lighting/light_sources.py", "towards) / distance**2)", "towards) / distance)",
     "composite/test_lamps.py"),
    ("composite/lighting/light_sources.py", "path = distance + back", "path = distance", "composite/test_lamps.py"),
    ("composite/lighting/light_sources.py", "return 1.0 + (ratio - 1.0) * contrast", "return ratio * contrast",
     "composite/test_gl.py"),
    ("composite/snow/draw.py", "np.sum(direction * towards, axis=-1)",
     "np.sum(-direction * towards, axis=-1)", ""),
    ("composite/snow/particles.py", "(low_m, high_m, -exponent)", "(low_m, high_m, 1.0 - exponent)", ""),
    ("composite/at_surface/surface_layer.py", "light if sides.in_water else light / square", "light",
     "composite/test_at_surface.py"),
    ("composite/gl/shaders/layer.frag", "parts.sun * (1.0 - 1.0 / max(waves, 1e-6))", "parts.sun",
     "composite/test_gl.py agreement composite/test_exr_layers.py"),
    ("composite/gl/object_pass.py", "bias = visibility.bias *", "bias = -visibility.bias *",
     "composite/test_scale.py composite/test_lamps.py composite/test_gl.py"),
    ("surface/water_light.py", "floor_m + depth_m, floor_m, 0.0", "floor_m, floor_m, 0.0", "surface/test_picture.py"),
    ("video/pixels/grain.py", "- twice + block[r, c + lag]", "+ twice + block[r, c + lag]", "video/test_grain.py"),
    ("video/pixels/kernels.py", "+ np.float32(0.5)", "+ np.float32(0.0)", "video/test_grain.py video/test_planes.py"),
    ("cache.py", "array.dtype.str, array.shape, array.tobytes()", "array.dtype.str, array.shape", "test_cache.py"),
    ("output_gate.py", "lock.acquire(timeout=0)", "None", "runs/test_resuming.py"),
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
