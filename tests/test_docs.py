# SPDX-License-Identifier: Apache-2.0
"""What the documentation says is what the program does."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import mr360uw
from mr360uw.scene.handbook import parameters_markdown

ROOT = Path(__file__).resolve().parents[1]


def test_the_page_of_parameters_is_current() -> None:
    assert (ROOT / "docs" / "parameters.md").read_text("utf-8") == parameters_markdown()


def test_every_parameter_says_what_it_means() -> None:
    for line in parameters_markdown().splitlines():
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


def test_the_version_is_said_once() -> None:
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    assert f'version = "{mr360uw.__version__}"' in text


CITING = ["optics.py", "constants.py", "caustics", "medium", "sample"]
"""Modules and folders whose docstrings cite entries of references.bib."""
CITATION = re.compile(
    r"\b((?:van de )?[A-Z][A-Za-z'-]+)(?: & [A-Z][A-Za-z'-]+| et al\.)? ((?:1[89]|20)\d\d(?:, (?:1[89]|20)\d\d)*)\b"
)


def docstrings(path: Path) -> str:
    """Return the docstrings of a module, those of its constants included, as one line."""
    strings = (
        node.value.value
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    )
    return re.sub(r"\s+", " ", " | ".join(strings))


def test_every_citation_has_an_entry_and_every_entry_is_cited() -> None:
    package = Path(mr360uw.__file__).parent
    modules = [
        f for name in CITING for f in ([package / name] if name.endswith(".py") else (package / name).rglob("*.py"))
    ]
    cited = {
        re.sub(r"[^A-Za-z]", "", name) + year
        for module in modules
        for name, years in CITATION.findall(docstrings(module))
        for year in years.split(", ")
    }
    cited.remove("CIE1931")  # the name of an observer
    entries = re.findall(r"^@\w+\{(\w+),\n(.*?)^\}", (package / "references.bib").read_text("utf-8"), re.M | re.S)
    assert cited == {key for key, _ in entries}
    for key, fields in entries:
        found = dict(re.findall(r"^  (\w+) = \{(.*?)\},?$", fields, re.M | re.S))
        assert found.keys() >= {"author", "title", "year"}, key
        assert key.endswith(found["year"]), key
        assert "doi" not in found or re.fullmatch(r"10\.\d{4,5}/\S+", found["doi"]), key
