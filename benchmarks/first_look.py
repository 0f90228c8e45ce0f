# SPDX-License-Identifier: Apache-2.0
"""First pictures of real plates and meshes: every mesh in every plate, as `mr360uw new` writes the scene.

    python benchmarks/first_look.py PLATES MESHES --out FOLDER [--water WORD] [--width 2048]

PLATES and MESHES are folders, searched with all below them. Scenes, previews and sheets are written into FOLDER:
`sheet.png` has a row for a plate and a column for a mesh, each body as an ordinary camera of 60 degrees sees it with a
close-up below it; the rows are there one by one too (`sheet.PLATE.png`). Composites are at most `--width` pixels wide.
A plate is under water if WORD is in its path (default "underwater"): the table says whether `new` found the same, the
angle under which the object is seen, its highest and lowest elevation. What is refused is listed with the reason.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from mr360uw.base.color import encode
from mr360uw.errors import Mr360uwError
from mr360uw.first_look.first_scene import make_first_scene
from mr360uw.preview.live import LivePreview
from mr360uw.preview.screen import look, perspective
from mr360uw.render.loaded import load
from mr360uw.scene.model import Scene, load_scene

PLATES = (".jpg", ".png", ".exr", ".hdr", ".mp4", ".mov", ".mkv", ".webm")
MESHES = (".glb", ".gltf", ".obj", ".ply", ".stl")
VIEW = (480, 360)
ORDINARY_DEG, CLOSE = 60.0, 1.5
"""Field of view of an ordinary camera [deg], and that of a close-up over the angle of its body."""
GREY = 0.18
"""What the median of a float plate is shown as: such plates have no exposure of their own."""


def files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Return the files of these suffixes in a folder and all below it."""
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in suffixes)


def rays(scene: Scene) -> np.ndarray:
    """Return the directions (n, 3) in which the camera sees the points of the object's hull."""
    loaded = load(scene, 1024, 512)
    view = loaded.view(0.0)
    placed = loaded.objects[0].at(0.0, 0, view.position, view.world_from_camera)
    points = placed.to_world(placed.mesh.hull.reshape(-1, 3)) - view.position
    return (points / np.linalg.norm(points, axis=-1, keepdims=True)) @ view.world_from_camera


def seen(live: LivePreview, scene: Scene, ray: np.ndarray, wide_deg: float, width: int) -> np.ndarray:
    """Return a composite's body (height, width, 3) in 8-bit codes: as an ordinary camera sees it, and close up."""
    frame = live.frame(scene, 0, min(width, live.loaded(scene).width)).picture
    light = frame.image_linear
    exposure = GREY / max(float(np.median(light)), 1e-6) if scene.plate.path.suffix in (".hdr", ".exr") else 1.0
    middle = 0.5 * (ray.min(axis=0) + ray.max(axis=0))
    yaw, pitch = np.degrees([np.arctan2(middle[0], -middle[2]), np.arctan2(middle[1], np.hypot(middle[0], middle[2]))])
    both = []
    for fov in (ORDINARY_DEG, min(max(CLOSE * wide_deg, 8.0), 100.0)):
        view = look(np.clip(exposure * light, 0.0, 1.0), perspective(float(yaw), float(pitch), fov, *VIEW))
        both.append(np.round(255.0 * encode(np.minimum(view, 1.0), "srgb")).astype(np.uint8)[..., ::-1])
    return np.concatenate(both)


def main() -> None:
    """Make the scenes, print what was found, write the sheets."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plates", type=Path)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--water", default="underwater")
    parser.add_argument("--width", type=int, default=2048)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    right, count, rows, refused = 0, 0, [], []
    for plate in files(given.plates, PLATES):
        row = []
        for mesh in files(given.meshes, MESHES):
            started, out = time.process_time(), given.out / f"{plate.stem}.{mesh.stem}.toml"
            try:
                _, lines, _ = make_first_scene(plate, mesh, out, overwrite=True)
                scene = load_scene(out)
                ray = rays(scene)
                widest = float(np.degrees(np.arccos(np.clip((ray @ ray.T).min(), -1.0, 1.0))))
                with LivePreview() as live:
                    cell = seen(live, scene, ray, widest, given.width)
            except Mr360uwError as error:
                refused.append(f"{plate.name}, {mesh.name}: {error}")
                continue
            wet = "air" not in next(line for line in lines if line.startswith("where")).split(":")[0]
            same = wet == (given.water in str(plate.relative_to(given.plates)))
            right, count = right + same, count + 1
            elevation = np.degrees(np.arcsin(ray[:, 1]))
            told = f"{'water' if wet else 'air'} {'right' if same else 'WRONG'}"
            place = f"{widest:.0f} deg wide, from {elevation.min():.0f} to {elevation.max():.0f} deg"
            seconds = time.process_time() - started
            print(f"{plate.name} + {mesh.name}: {told}, {place}, {seconds:.1f} s of processor")
            print(*(f"    {line}" for line in lines), sep="\n", flush=True)
            row.append(cv2.putText(cell, out.stem, (6, 16), 0, 0.45, (0, 0, 255), 1))
        if row:
            rows.append(np.concatenate(row, axis=1))
            cv2.imwrite(str(given.out / f"sheet.{plate.stem}.png"), rows[-1])
    print(f"{right} of {count} plates told right; {len(refused)} refused")
    print("\n".join(f"refused: {line}" for line in refused))
    widest_row = max((row.shape[1] for row in rows), default=0)
    if rows:
        cv2.imwrite(
            str(given.out / "sheet.png"),
            np.concatenate([np.pad(row, ((0, 0), (0, widest_row - row.shape[1]), (0, 0))) for row in rows]),
        )


if __name__ == "__main__":
    main()
