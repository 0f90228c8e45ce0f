# SPDX-License-Identifier: Apache-2.0
"""What the documentation says is what the program does."""

from __future__ import annotations

import inspect
import re
import runpy
import shlex
import shutil
import tomllib
from pathlib import Path

import click
import pytest
import typer
from PIL import Image

import mr360uw
from mr360uw.from_above.settings import aerial_handbook
from mr360uw.render.frame import blend_frame, composite_frame, draw_frame, frame_shots
from mr360uw.sample import DiveSettings, SampleDive
from mr360uw.scene.handbook import parameters_markdown, table_of

ROOT = Path(__file__).resolve().parents[1]


def test_the_page_of_parameters_is_current() -> None:
    assert (ROOT / "docs" / "parameters.md").read_text("utf-8") == parameters_markdown()
    assert (ROOT / "docs" / "aerial-parameters.md").read_text("utf-8") == aerial_handbook()


def test_every_table_of_a_scene_has_a_task() -> None:
    for scene, page in ((mr360uw.Scene, parameters_markdown()), (mr360uw.AerialScene, aerial_handbook())):
        for name, field in scene.model_fields.items():
            assert re.search(rf"^(###|As in .*) `\[+{field.alias or name}[\].]", page, re.M), name
    assert parameters_markdown().index("## The plate") < parameters_markdown().index("## Rendering")


def test_the_page_of_the_sample_dive_has_its_parameters() -> None:
    table = "\n".join(table_of("--set", DiveSettings))
    assert table in (ROOT / "docs" / "sample.md").read_text("utf-8")


def test_every_parameter_says_what_it_means() -> None:
    for line in (parameters_markdown() + aerial_handbook()).splitlines():
        if line.startswith("| `"):
            assert len(line.split(" | ")[-1].strip(" |")) > 3, line


def test_every_command_is_on_its_page() -> None:
    from mr360uw.cli import app

    text = (ROOT / "docs" / "commands.md").read_text("utf-8")
    for command in app.registered_commands:
        name = command.name or command.callback.__name__
        assert f"`{name}" in text, name
        assert command.callback.__doc__


def test_links_and_pictures_of_the_pages_exist() -> None:
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), ROOT / "samples" / "README.md"]:
        for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text("utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_pictures_of_the_pages_are_made_by_their_program_and_are_small() -> None:
    """Each has its entry in docs/pictures.py, which makes no others; a reader loads less than 400 kB for one."""
    shown = set()
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        shown |= {Path(target).name for target in re.findall(r"!\[[^]]*\]\(([^)]+)\)", page.read_text("utf-8"))}
    program = runpy.run_path(str(ROOT / "docs" / "pictures.py"))
    kept = {path.name for kind in ("png", "jpg", "webp", "gif") for path in (ROOT / "docs").glob(f"*.{kind}")}
    assert shown == set(program["PICTURES"]) == kept
    for name in shown:
        assert (ROOT / "docs" / name).stat().st_size < program["LARGEST_BYTES"] == 400_000, name
        with Image.open(ROOT / "docs" / name) as picture:
            assert getattr(picture, "is_animated", False) or picture.width >= 1600, name


def test_extras_are_named_in_one_way() -> None:
    """In quotes, which every shell needs or bears: of what is installed, or of a clone."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs").glob("notebooks/*.ipynb")]
    for page in [*pages, *Path(mr360uw.__file__).parent.rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")]:
        for quote, names, end in re.findall(r"(\S?)(?:mr360uw|\.)\[([a-z,]+)\](.?)", page.read_text("utf-8")):
            if set(names.split(",")) <= set(extras):
                assert quote == end == "'", f"{page.name}: [{names}]"


def test_the_scene_of_the_readme_runs(dive: SampleDive, tmp_path: Path) -> None:
    text = re.findall(r"^```toml\n(.*?)^```$", (ROOT / "README.md").read_text("utf-8"), re.M | re.S)[0]
    assert text.count("\n") == 5
    for file in (dive.plate, dive.mesh):
        shutil.copy(file, tmp_path)
    (tmp_path / "dive.toml").write_text(text, "utf-8")
    scene = mr360uw.load_scene(tmp_path / "dive.toml")
    assert mr360uw.composite_video(scene, tmp_path / "out.mp4", frames=(0, 1)).frames == 1


def test_the_frame_in_the_design_is_the_frame() -> None:
    text = (ROOT / "docs" / "design.md").read_text("utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    stages = (composite_frame, frame_shots, draw_frame, blend_frame)
    assert blocks == ["\n\n".join(inspect.getsource(stage) for stage in stages)]


def test_files_named_in_the_pages_exist() -> None:
    """Paths below the package, and names of its modules and shaders, in backquotes."""
    package = Path(mr360uw.__file__).parent
    names = {path.name for folder in (package, ROOT / "tests", ROOT / "benchmarks") for path in folder.rglob("*.*")}
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]:
        for named in re.findall(r"`([\w/]+(?:\.py|\.glsl|\.bib|/))`", page.read_text("utf-8")):
            found = named in names or any((root / named).exists() for root in (ROOT, package))
            assert found or list(package.rglob(named)), f"{page.name}: {named}"


def test_the_version_is_said_once() -> None:
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    assert f'version = "{mr360uw.__version__}"' in text


CITATION = re.compile(
    r"\b((?:van de )?[A-Z][A-Za-z'-]+)(?: & (?:de )?[A-Z][A-Za-z'-]+| et al\.)?"
    r" ((?:1[89]\d\d|20[0-4]\d)(?:, (?:1[89]\d\d|20[0-4]\d))*)\b"
)
NAMES = {"CIE1931"}
"""Names that look like a citation: the CIE 1931 observer."""


def citations(path: Path) -> set[str]:
    """Return the keys of what a source cites, as "Porter1984" for "Porter & Duff 1984"."""
    text = re.sub(r"\s+(?:(?:#|//) )?", " ", path.read_text("utf-8"))
    return {
        re.sub(r"[^A-Za-z]", "", name) + year for name, years in CITATION.findall(text) for year in years.split(", ")
    }


def test_citations_are_read() -> None:
    """The forms that the sources use, one of them broken over two lines."""
    assert citations(Path(mr360uw.__file__).parent / "base" / "tile_blend.py") == {"Debevec1998", "Porter1984"}
    assert {"Bricaud1998", "Loisel1998"} <= citations(Path(mr360uw.__file__).parent / "medium" / "water.py")


def test_every_citation_has_an_entry_and_every_entry_is_cited() -> None:
    package = Path(mr360uw.__file__).parent
    sources = [path for ending in ("py", "glsl", "frag", "vert", "geom") for path in package.rglob(f"*.{ending}")]
    sources += (ROOT / "samples").rglob("*.py")
    cited = set().union(*map(citations, sources)) - NAMES
    entries = re.findall(r"^@\w+\{(\w+),\n(.*?)^\}", (package / "references.bib").read_text("utf-8"), re.M | re.S)
    keys = [key for key, _ in entries]
    assert cited == set(keys)
    assert keys == sorted(set(keys), key=str.lower), "entries stand in the order of their keys, each once"
    for key, fields in entries:
        found = dict(re.findall(r"^  (\w+) = \{(.*?)\},?$", fields, re.M | re.S))
        assert found.keys() >= {"author", "title", "year"}, key
        assert key.endswith(found["year"]), key
        assert "doi" not in found or re.fullmatch(r"10\.\d{4,5}/\S+", found["doi"]), key


def said_commands() -> list[tuple[str, list[str]]]:
    """Return (page, words) of every line of code in the pages that calls the command line."""
    found = []
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), ROOT / "samples" / "README.md"]:
        text = page.read_text("utf-8").replace("\\\n", " ")
        fenced = False
        for line in text.splitlines():
            fenced ^= line.startswith("```")
            if line.startswith("    mr360uw ") or (fenced and line.startswith("mr360uw ")):
                found.append((page.name, shlex.split(line, comments=True)[1:]))
    return found


def test_commands_of_the_pages_are_understood() -> None:
    """Each is parsed as the shell would give it: known command, known options, values of their kind."""
    from mr360uw.cli import app

    program = typer.main.get_command(app)
    said = said_commands()
    assert len(said) > 20
    for page, words in said:
        if words[0].startswith("--"):
            assert any(words[0] in option.opts for option in program.params), f"{page}: {words}"
            continue
        command = program.get_command(click.Context(program), words[0])
        assert command is not None, f"{page}: {words}"
        try:
            command.make_context(words[0], words[1:], resilient_parsing=False)
        except click.UsageError as error:
            raise AssertionError(f"{page}: mr360uw {' '.join(words)}: {error.format_message()}") from error


def test_the_library_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "library.md").read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    known: dict[str, object] = {}
    exec("\n".join(re.findall(r"^```python\n(.*?)^```$", text, re.M | re.S)), known)
    assert known["report"].frames == 2
    assert abs(known["ratio"].mean() - 1.0) < 1e-6
    assert (tmp_path / "try" / "out.mp4").exists()


def test_every_page_is_in_the_site() -> None:
    listed = set(re.findall(r"([\w-]+\.md)$", (ROOT / "mkdocs.yml").read_text("utf-8"), re.M))
    assert listed == {page.name for page in (ROOT / "docs").glob("*.md")}
