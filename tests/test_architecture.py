# SPDX-License-Identifier: Apache-2.0
"""The architecture that docs/design.md states, checked on the sources."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import mr360uw

ROOT = Path(mr360uw.__file__).parent
GROUND = {"files", "types", "constants", "sphere", "color", "errors", "parameters", "optics", "shapes"}
# what a package may import of mr360uw besides the ground floor and itself
ALLOWED: dict[str, set[str]] = {
    "ibl": {"gl"},
    "caustics": {"gl"},
    "medium": {"gl"},
    "composite": {"gl", "ibl", "caustics", "medium"},
    "gl": set(),
    "video": set(),
}
HEAVY = {"colour", "trimesh", "moderngl", "av", "cv2", "OpenEXR", "numba", "matplotlib", "scipy"}


def imports(path: Path) -> set[str]:
    """Return the modules a file imports, anywhere in it, as dotted names."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module)
            if node.module == "mr360uw":
                names |= {f"mr360uw.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_packages_import_only_what_they_may(package: str) -> None:
    allowed = GROUND | {package} | ALLOWED[package]
    for path in (ROOT / package).rglob("*.py"):
        used = {name.split(".")[1] for name in imports(path) if name.startswith("mr360uw.")}
        assert used <= allowed, f"{path.relative_to(ROOT)} imports {used - allowed}"


@pytest.mark.parametrize("package", ["ibl", "caustics", "medium", "composite"])
def test_only_gl_modules_of_a_physics_package_know_opengl(package: str) -> None:
    for path in (ROOT / package).rglob("*.py"):
        if "gl" not in path.relative_to(ROOT).parts:
            runtime = {n for n in imports(path) if n.startswith("mr360uw.gl") or n == "moderngl"}
            assert not runtime, f"{path.relative_to(ROOT)} imports {runtime}"


def test_the_ground_floor_stands_on_numpy_alone() -> None:
    for name in GROUND:
        used = {n.split(".")[0] for n in imports(ROOT / f"{name}.py")}
        assert used <= {"mr360uw", "numpy", "pydantic", "__future__", "math", "dataclasses", "typing", "pathlib"}, name


def test_every_pure_shader_has_its_python_twin() -> None:
    for path in ROOT.rglob("*.glsl"):
        if "gl" in path.relative_to(ROOT).parts:
            continue  # only the device has it
        twin = path.with_suffix(".py")
        assert twin.is_file(), f"{path.relative_to(ROOT)} has no twin"
        assert "twin:" in path.read_text("utf-8").splitlines()[0]


def test_pure_shaders_touch_no_pipeline_state() -> None:
    for path in ROOT.rglob("*.glsl"):
        code = re.sub(r"//.*", "", path.read_text("utf-8"))
        assert not re.search(r"\bgl_\w+|\buniform\b|\blayout\b", code), path.relative_to(ROOT)


def test_public_names_exist_and_no_name_hides_a_package() -> None:
    for name in mr360uw.__all__:
        assert getattr(mr360uw, name) is not None
    assert not (set(mr360uw.__all__) & {"gl", "tune", "sample"})


@pytest.mark.parametrize("statement", ["import mr360uw", "import mr360uw.cli", "import mr360uw.errors"])
def test_importing_loads_nothing_heavy(statement: str) -> None:
    code = f"{statement}; import sys; print(*{{m.split('.')[0] for m in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not HEAVY & set(done.stdout.split())


def test_the_sources_speak_of_the_project_alone() -> None:
    for path in [*ROOT.rglob("*.py"), *ROOT.rglob("*.glsl"), *ROOT.rglob("*.frag"), *ROOT.rglob("*.geom")]:
        text = path.read_text("utf-8")
        assert "SPDX-License-Identifier" in text or path.suffix != ".py", path.relative_to(ROOT)
        assert not re.search(r"\b(TODO|FIXME|XXX)\b", text), path.relative_to(ROOT)
