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
GROUND = {"files", "types", "constants", "sphere", "color", "errors", "parameters", "optics", "shapes", "yuv", "cache"}
# what a package may import of mr360uw besides the ground floor and itself
ALLOWED: dict[str, set[str]] = {
    "ibl": {"gl"},
    "caustics": {"gl"},
    "medium": {"gl"},
    "composite": {"gl", "ibl", "caustics", "medium"},
    "gl": set(),
    "video": set(),
}
# folders, and "" for the modules beside them, from which no chain of imports leads back to where it began
WITHOUT_CIRCLES = ["", "composite", "gl", "ibl", "render", "sample", "scene", "video", "yuv"]
# folders whose shaders' functions all have a partner of the same name in Python
PAIRED = ["", "ibl"]
# folders whose citations all stand in references.bib, as "Karis 2013" for the key Karis2013
CITED = ["ibl", "video", "scene", "yuv"]
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
    stands_on = {"mr360uw", "numpy", "pydantic"}
    library = {"__future__", "math", "dataclasses", "typing", "pathlib", "functools", "collections"}
    compiled = {ROOT / "yuv" / "decode_kernels.py": {"numba"}}
    for name in GROUND:
        for path in (ROOT / name).rglob("*.py") if (ROOT / name).is_dir() else [ROOT / f"{name}.py"]:
            used = {n.split(".")[0] for n in imports(path)}
            assert used <= stands_on | library | compiled.get(path, set()), path.relative_to(ROOT)
            mine = {n.split(".")[1] for n in imports(path) if n.startswith("mr360uw.")}
            assert mine <= GROUND, path.relative_to(ROOT)


def circles(graph: dict[str, set[str]]) -> list[set[str]]:
    """Return the sets of more than one module that all reach each other (Warshall 1962 on the modules' reach)."""
    reach = {name: set(targets) for name, targets in graph.items()}
    for between in graph:
        for name in graph:
            if between in reach[name]:
                reach[name] |= reach[between]
    return [{m for m in reach[name] if name in reach[m]} for name in graph if name in reach[name]]


def test_circles_are_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == [{"b", "c"}, {"b", "c"}]


@pytest.fixture(scope="module")
def import_circles() -> list[set[str]]:
    """Circles over every import statement: at the top, inside functions, and for type checking."""
    paths = {".".join(p.relative_to(ROOT.parent).with_suffix("").parts): p for p in ROOT.rglob("*.py")}
    modules = {name.removesuffix(".__init__"): path for name, path in paths.items()}
    graph = {name: _imported_modules(path) & set(modules) - {name} for name, path in modules.items()}
    assert graph["mr360uw.yuv.decoding"] >= {"mr360uw.types", "mr360uw.yuv.decode_kernels"}
    return circles(graph)


def _imported_modules(path: Path) -> set[str]:
    """Return `imports`, and what they would be if the names imported from a package were modules of it."""
    names = imports(path)
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("folder", WITHOUT_CIRCLES)
def test_no_module_imports_itself_by_a_circle(folder: str, import_circles: list[set[str]]) -> None:
    for circle in import_circles:
        for name in circle:
            parts = name.split(".")[1:]
            assert (parts[0] if len(parts) > 1 else "") != folder, sorted(circle)


def test_every_pure_shader_has_its_python_twin() -> None:
    for path in ROOT.rglob("*.glsl"):
        if "gl" in path.relative_to(ROOT).parts:
            continue  # only the device has it
        twin = path.with_suffix(".py")
        assert twin.is_file(), f"{path.relative_to(ROOT)} has no twin"
        assert "twin:" in path.read_text("utf-8").splitlines()[0]


@pytest.mark.parametrize("folder", PAIRED)
def test_every_function_of_a_pure_shader_has_its_partner(folder: str) -> None:
    for path in (ROOT / folder).glob("*.glsl"):
        code = re.sub(r"//.*", "", path.read_text("utf-8"))
        shader = set(re.findall(r"^\w+ (\w+)\([^;{]*\)\s*\{", code, re.MULTILINE))
        tree = ast.parse(path.with_suffix(".py").read_text("utf-8"))
        python = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        assert shader, path.relative_to(ROOT)
        assert shader <= python, f"{path.relative_to(ROOT)} alone has {shader - python}"


def test_pure_shaders_touch_no_pipeline_state() -> None:
    for path in ROOT.rglob("*.glsl"):
        code = re.sub(r"//.*", "", path.read_text("utf-8"))
        assert not re.search(r"\bgl_\w+|\buniform\b|\blayout\b", code), path.relative_to(ROOT)


@pytest.mark.parametrize("folder", CITED)
def test_citations_stand_in_the_references(folder: str) -> None:
    keys = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "references.bib").read_text("utf-8"), re.MULTILINE))
    for path in (ROOT / folder).rglob("*.py"):
        cited = {a + year for a, year in re.findall(r"\b([A-Z][a-z]+) ((?:18|19|20)\d\d)\b", path.read_text("utf-8"))}
        assert cited <= keys, path.relative_to(ROOT)


def test_the_references_are_cited() -> None:
    text = "".join(path.read_text("utf-8") for path in ROOT.rglob("*.py"))
    entries = re.findall(
        r"^@\w+\{([A-Z][a-z]+)(\d{4}),(.*?)^\}", (ROOT / "references.bib").read_text("utf-8"), re.M | re.S
    )
    assert entries
    for author, year, fields in entries:
        assert f"{author} {year}" in text, f"{author}{year} is cited nowhere"
        assert re.search(r"author +=.*title +=.*year +=", fields, re.S), f"{author}{year} lacks author, title or year"


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
