# SPDX-License-Identifier: Apache-2.0
"""What the documentation says is what the program does."""

from __future__ import annotations

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
