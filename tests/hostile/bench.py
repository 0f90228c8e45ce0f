# SPDX-License-Identifier: Apache-2.0
"""A scene that runs, and what every refusal must be: exit code 2, a message with its place, and nothing written."""

from __future__ import annotations

import re
import stat
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from mr360uw import cli
from tests.command import command_line
from tests.composite.gltf_files import one_square

LONGEST_S = 60.0  # far above compiling on two busy cores with empty caches, far below work that a limit forbids
"""Time in which bad input must be refused."""
SCENE = """[plate]
path = "plate.png"
[water]
type = "none"
[[object]]
mesh = "mesh.glb"
"""


@dataclass(frozen=True)
class Material:
    """Bytes of good files by name."""

    files: dict[str, bytes]


def make_material(folder: Path) -> Material:
    """Return a plate of 64 x 32, a mesh and pictures of other kinds."""
    rng = np.random.default_rng(360)
    codes = rng.integers(0, 255, (32, 64, 3), np.uint8)
    for suffix in (".png", ".jpg", ".tif", ".bmp", ".webp"):
        cv2.imwrite(str(folder / f"plate{suffix}"), codes)
    cv2.imwrite(str(folder / "plate.hdr"), np.float32(codes) / 255.0)
    from mr360uw.video import write_exr

    write_exr(folder / "plate.exr", np.float32(codes) / 255.0)
    one_square().write(folder / "mesh.glb")
    one_square().write(folder / "mesh.gltf")
    return Material({path.name: path.read_bytes() for path in folder.iterdir()})


def contents(folder: Path) -> dict[str, bytes | None]:
    """Return the names of everything in a folder, with the bytes of files."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if stat.S_ISREG(path.lstat().st_mode) else None
        for path in sorted(folder.rglob("*"))
    }


class Bench:
    """A folder with a scene that runs, and the command line."""

    def __init__(
        self,
        folder: Path,
        material: Material,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        self.folder, self.material = folder, material
        self._patch, self._captured = monkeypatch, capsys
        monkeypatch.setattr(cli, "app", command_line())
        for name in ("plate.png", "mesh.glb"):
            self.put(name, material.files[name])
        self.put("scene.toml", SCENE)

    def put(self, name: str, data: bytes | str) -> Path:
        """Write a file and return its path."""
        path = self.folder / name
        path.write_bytes(data.encode() if isinstance(data, str) else data)
        return path

    def run(self, *arguments: str | Path) -> tuple[int, str, str]:
        """Run the command line; return exit code, output and errors."""
        self._patch.setattr(sys, "argv", ["mr360uw", *map(str, arguments)])
        code = 0
        try:
            cli.main()
        except SystemExit as done:
            code = int(done.code or 0)
        captured = self._captured.readouterr()
        return code, captured.out, captured.err

    def refuses(self, *arguments: str | Path, says: tuple[str, ...] = ()) -> str:
        """Check that a command is refused as it must be; return the message."""
        before, since = contents(self.folder), time.perf_counter()
        code, out, err = self.run(*arguments)
        assert time.perf_counter() - since < LONGEST_S
        assert code == 2, (code, out, err)
        assert "Traceback" not in err
        assert re.search(r"^error: .+ - |^  .+ - ", err, re.MULTILINE) or "Usage:" in err, err
        for part in says:
            assert part in err, err
        assert contents(self.folder) == before
        return err

    def refuses_scene(self, text: str, *says: str) -> str:
        """Check that a scene is refused."""
        self.put("scene.toml", text)
        return self.refuses("composite", "scene.toml", "out.png", "--backend", "reference", says=("scene.toml", *says))

    def refuses_with(self, *settings: str, says: tuple[str, ...] = (), out: str = "out.png") -> str:
        """Check that the scene is refused with settings of the command line."""
        chosen = [part for setting in settings for part in ("--set", setting)]
        return self.refuses("composite", "scene.toml", out, *chosen, "--backend", "reference", says=says)
