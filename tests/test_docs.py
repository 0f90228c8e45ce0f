# SPDX-License-Identifier: Apache-2.0
"""What the documentation says is what the program does."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import mr360uw
from mr360uw.from_above.settings import aerial_handbook
from mr360uw.render.frame import frame_stages
from mr360uw.sample import DiveSettings
from mr360uw.scene.handbook import parameters_markdown, table_of

ROOT = Path(__file__).resolve().parents[1]


def test_the_page_of_parameters_is_current() -> None:
    assert (ROOT / "docs" / "parameters.md").read_text("utf-8") == parameters_markdown()
    assert (ROOT / "docs" / "aerial-parameters.md").read_text("utf-8") == aerial_handbook()


def test_the_page_of_the_sample_dive_has_its_parameters() -> None:
    table = "\n".join(table_of("--set", DiveSettings))
    assert table in (ROOT / "docs" / "sample.md").read_text("utf-8")


def test_every_parameter_says_what_it_means() -> None:
    for line in (parameters_markdown() + aerial_handbook()).splitlines():
        if line.startswith("| `"):
            assert len(line.split(" | ")[-1].strip(" |")) > 3, line


def test_every_command_is_in_the_readme() -> None:
    from mr360uw.cli import app

    text = (ROOT / "README.md").read_text("utf-8")
    for command in app.registered_commands:
        name = command.name or command.callback.__name__
        assert f"`{name}" in text, name
        assert command.callback.__doc__


def test_links_and_pictures_of_the_pages_exist() -> None:
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), ROOT / "samples" / "README.md"]:
        for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text("utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_frame_in_the_design_is_the_frame() -> None:
    text = (ROOT / "docs" / "design.md").read_text("utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert blocks == [inspect.getsource(frame_stages)]


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
    assert citations(Path(mr360uw.__file__).parent / "composite" / "over.py") == {"Debevec1998", "Porter1984"}
    assert {"Bricaud1998", "Loisel1998"} <= citations(Path(mr360uw.__file__).parent / "medium" / "water.py")


def test_every_citation_has_an_entry_and_every_entry_is_cited() -> None:
    package = Path(mr360uw.__file__).parent
    sources = [path for ending in ("py", "glsl", "frag", "vert", "geom") for path in package.rglob(f"*.{ending}")]
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
