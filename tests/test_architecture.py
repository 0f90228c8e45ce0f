# SPDX-License-Identifier: Apache-2.0
"""The architecture that docs/design.md states, checked on the sources."""

from __future__ import annotations

import ast
import importlib
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

import mr360uw

ROOT = Path(mr360uw.__file__).parent
GROUND = {"base", "types", "errors", "yuv", "jit", "plot"}
# what a package may import of mr360uw besides the ground floor and itself
PHYSICS = {"ibl", "caustics", "medium"}
ALLOWED: dict[str, set[str]] = {
    "published": set(),
    "ibl": {"published"},
    "caustics": {"published"},
    "medium": set(),
    "surface": {*PHYSICS},
    "from_above": {"surface", "scene", "sample", "composite", "video", "published", *PHYSICS},
    "composite": {"gl", "surface", *PHYSICS},
    "gl": set(),
    "video": set(),
    "scene": {"composite", "video", *PHYSICS},
    "render": {"depth", "scene", "composite", "video", "gl", *PHYSICS},
    "runs": {"preview", "render", "scene", "composite", "video", "__version__", *PHYSICS},
    "preview": {"render", "scene", "video", "composite", *PHYSICS},
    "match": {"render", "scene", "video", *PHYSICS},
    "sample": {"scene", "ibl", "caustics", "medium", "surface", "video"},
    "bench": {
        "preview",
        "render",
        "scene",
        "composite",
        "sample",
        "video",
        "info",
        "__version__",
        *PHYSICS,
    },
    "depth": {"track", "video", "composite", "medium"},
    "track": {"video", "ibl", "medium", "composite"},
    "first_look": {"depth", "track", "match", "preview", "render", "scene", "composite", "video", *PHYSICS},
    "tune": {
        "match",
        "preview",
        "runs",
        "render",
        "scene",
        "composite",
        "video",
        *PHYSICS,
    },
}
HEAVY = {
    "colour",
    "trimesh",
    "moderngl",
    "av",
    "cv2",
    "OpenEXR",
    "numba",
    "matplotlib",
    "scipy",
    "nicegui",
    "pycolmap",
    "numpy",
    "pydantic",
}


def test_only_the_command_line_takes_a_first_look() -> None:
    for path in ROOT.rglob("*.py"):
        if path.relative_to(ROOT).parts[0] not in ("first_look", "cli"):
            assert "mr360uw.first_look" not in path.read_text("utf-8"), path.relative_to(ROOT)


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


def test_packages_import_only_what_they_may(subtests: pytest.Subtests) -> None:
    for package in sorted(ALLOWED):
        with subtests.test(package):
            allowed = GROUND | {package} | ALLOWED[package]
            for path in (ROOT / package).rglob("*.py"):
                used = {name.split(".")[1] for name in imports(path) if name.startswith("mr360uw.")}
                assert used <= allowed, f"{path.relative_to(ROOT)} imports {used - allowed}"


def test_benchmarks_import_what_is_there(subtests: pytest.Subtests) -> None:
    for path in (ROOT.parent / "benchmarks").rglob("*.py"):
        with subtests.test(path.name):
            for node in ast.walk(ast.parse(path.read_text("utf-8"))):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mr360uw"):
                    module = importlib.import_module(str(node.module))
                    for alias in node.names:
                        if not hasattr(module, alias.name):
                            importlib.import_module(f"{module.__name__}.{alias.name}")


def test_every_benchmark_is_started_at_its_smallest() -> None:
    """What benchmarks/smallest.py does not start is found broken when it is needed."""
    benchmarks = ROOT.parent / "benchmarks"
    starts = runpy.run_path(str(benchmarks / "smallest.py"))["STARTS"]
    assert set(starts) == {path.stem for path in benchmarks.glob("*.py")}


def test_no_module_name_stands_twice() -> None:
    """But for those that mean the same in every package."""
    names = [p.stem for p in ROOT.rglob("*.py") if p.stem != "__init__"]
    assert {name for name in names if names.count(name) > 1} == {"settings", "lookup"}


def test_only_gl_modules_of_a_physics_package_import_opengl(subtests: pytest.Subtests) -> None:
    for package in ["ibl", "caustics", "medium", "composite", "surface"]:
        with subtests.test(package):
            for path in (ROOT / package).rglob("*.py"):
                if "gl" not in path.relative_to(ROOT).parts:
                    runtime = {n for n in imports(path) if n.startswith("mr360uw.gl") or n == "moderngl"}
                    assert not runtime, f"{path.relative_to(ROOT)} imports {runtime}"


def test_the_ground_floor_stands_on_numpy_alone() -> None:
    stands_on = {"mr360uw", "numpy", "pydantic"}
    library = {
        "__future__",
        "collections",
        "math",
        "dataclasses",
        "typing",
        "pathlib",
        "functools",
        "types",
        "weakref",
        "enum",
        "threading",
    }
    files = {
        ROOT / "jit" / "__init__.py": {"dis", "hashlib", "llvmlite", "numba", "os", "pickle", "platform", "sys"},
        ROOT / "jit" / "ahead.py": {
            "contextlib",
            "gc",
            "hashlib",
            "importlib",
            "itertools",
            "numba",
            "os",
            "queue",
            "subprocess",
            "sys",
        },
        ROOT / "base" / "cache.py": {"operator", "types"},
        ROOT / "base" / "color.py": {"colour", "warnings"},
        ROOT / "base" / "parameters.py": {"builtins", "fractions", "inspect", "operator", "re"},
        ROOT / "base" / "rays.py": {"embreex", "trimesh"},
        ROOT / "base" / "progress.py": {"concurrent", "contextlib", "os", "rich", "signal", "sys", "threadpoolctl"},
        ROOT / "plot.py": {"base64", "cv2", "html"},
        ROOT / "base" / "files.py": {
            "contextlib",
            "filelock",
            "hashlib",
            "itertools",
            "json",
            "os",
            "re",
            "secrets",
            "shutil",
            "stat",
        },
        ROOT / "errors.py": {"importlib"},
        ROOT / "base" / "disk_cache.py": {"contextlib", "hashlib", "io", "os", "zipfile"},
        ROOT / "base" / "input_files.py": {
            "contextlib",
            "contextvars",
            "csv",
            "hashlib",
            "importlib",
            "json",
            "os",
            "re",
            "stat",
            "struct",
            "unicodedata",
        },
    }
    yuv = {
        ROOT / "yuv" / "file_profile.py": {"hashlib", "struct"},
        ROOT / "yuv" / "ocio_transform.py": {"PyOpenColorIO", "re", "tempfile"},
    }
    for name in GROUND:
        for path in (ROOT / name).rglob("*.py") if (ROOT / name).is_dir() else [ROOT / f"{name}.py"]:
            used = {n.split(".")[0] for n in imports(path)}
            own = yuv.get(path, set()) | files.get(path, set())
            assert used <= stands_on | library | own, path.relative_to(ROOT)
            mine = {n.split(".")[1] for n in imports(path) if n.startswith("mr360uw.")}
            assert mine <= GROUND, path.relative_to(ROOT)


def test_one_place_compiles() -> None:
    """And a module makes a piece of machine code."""
    compiling = {
        str(path.relative_to(ROOT))
        for path in ROOT.rglob("*.py")
        if path.parent != ROOT / "jit" and re.search("^(import|from) numba", path.read_text("utf-8"), re.M)
    }
    assert compiling == set()


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


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__")


def lazy_names() -> dict[str, str]:
    """Return the module that defines each name of a package, as the packages' stubs list them."""
    names = {}
    for stub in ROOT.rglob("__init__.pyi"):
        for node in ast.walk(ast.parse(stub.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == 1 and node.module:
                source = f"{module_name(stub)}.{node.module}"
                names |= {f"{module_name(stub)}.{alias.name}": source for alias in node.names}
    return names


def import_graph() -> dict[str, set[str]]:
    """Return the modules that each module imports: at its top, inside functions and for type checking.

    A name imported from a package is counted as an import of the module that defines it.
    """
    modules, lazy = {module_name(path): path for path in ROOT.rglob("*.py")}, lazy_names()
    graph: dict[str, set[str]] = {}
    for name, path in modules.items():
        wanted: list[str] = []
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                wanted += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                wanted += [f"{node.module}.{alias.name}" for alias in node.names]
        found = {n if n in modules else lazy.get(n, n.rpartition(".")[0]) for n in wanted}
        graph[name] = (found & set(modules)) - {name}
    return graph


def test_no_module_imports_itself_by_a_circle() -> None:
    graph = import_graph()
    assert graph["mr360uw.yuv.decoding"] >= {"mr360uw.types"}
    assert graph["mr360uw.render.first_pass"] >= {"mr360uw.ibl.sun.track", "mr360uw.medium.medium"}
    assert [sorted(circle) for circle in circles(graph)] == []


def shaders(device: bool) -> list[Path]:
    """Return the shaders below a folder `gl`, which the device alone has, or all others."""
    endings = ("*.glsl", "*.frag", "*.vert", "*.geom")
    found = sorted(path for ending in endings for path in ROOT.rglob(ending))
    return [path for path in found if ("gl" in path.relative_to(ROOT).parts) == device]


def test_every_pure_shader_names_its_python_twin() -> None:
    assert shaders(device=False)
    for path in shaders(device=False):
        assert path.suffix == ".glsl", f"{path.relative_to(ROOT)} is a stage of a pipeline - move it below a folder gl"
        assert path.with_suffix(".py").is_file(), f"{path.relative_to(ROOT)} has no twin"
        assert path.read_text("utf-8").splitlines()[0].startswith(f"// twin: {path.stem}.py")


def test_every_shader_of_the_device_names_its_reference() -> None:
    """The first comment ends in "Held to MODULE.py", a path below the package."""
    assert shaders(device=True)
    for path in shaders(device=True):
        comment = re.match(r"(?://.*\n)+", path.read_text("utf-8"))
        assert comment, f"{path.relative_to(ROOT)} has no comment at its top"
        text = re.sub(r"\s*\n// ?", " ", comment[0])
        assert not re.search(r"\b[Tt]win\b", text), f"{path.relative_to(ROOT)} has no twin: the device alone has it"
        held = re.findall(r"\bHeld to ((?:[\w/]+\.py(?:, | and )?)+)", text)
        assert len(held) == 1, f"{path.relative_to(ROOT)} does not name the reference it is held to"
        for name in re.split(r", | and ", held[0]):
            assert (ROOT / name).is_file(), f"{path.relative_to(ROOT)} is held to {name}, which is not there"


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
