# SPDX-License-Identifier: Apache-2.0
"""First scenes of real plates and meshes: what `mr360uw new` finds, and whether the object is where it is seen.

    python benchmarks/first_look.py PLATES MESHES --out FOLDER [--water WORD] [--pairs 12] [--every]

PLATES and MESHES are folders, searched with all below them. Each plate gets the next mesh in turn, or every mesh with
--every. Scenes and previews are written into FOLDER, with a sheet of the previews; plates that are refused are listed
with the reason. A plate is under water if WORD is in its path (default "underwater"): the table says whether `new`
found the same, the angle under which the object is seen, and its highest and lowest elevation.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from mr360uw.errors import Mr360uwError
from mr360uw.first_look.first_scene import make_first_scene
from mr360uw.render.loaded import load
from mr360uw.scene.model import load_scene

PLATES = (".jpg", ".png", ".exr", ".hdr", ".mp4", ".mov", ".mkv", ".webm")
MESHES = (".glb", ".gltf", ".obj", ".ply", ".stl")
SHOWN = (640, 320)


def files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Return the files of these suffixes in a folder and all below it."""
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in suffixes)


def seen(scene_file: Path) -> tuple[float, float, float]:
    """Return the widest angle [deg] of the object's hull, and the highest and lowest elevation [deg] of its points."""
    scene = load_scene(scene_file)
    loaded = load(scene, 1024, 512)
    view = loaded.view(0.0)
    placed = loaded.objects[0].at(0.0, 0, view.position, view.world_from_camera)
    points = placed.to_world(placed.mesh.hull.reshape(-1, 3)) - view.position
    ray = points / np.linalg.norm(points, axis=-1, keepdims=True)
    widest = float(np.degrees(np.arccos(np.clip((ray @ ray.T).min(), -1.0, 1.0))))
    elevation = np.degrees(np.arcsin(ray[:, 1]))
    return widest, float(elevation.max()), float(elevation.min())


def main() -> None:
    """Make the scenes, print what was found, write the sheet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("plates", type=Path)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--water", default="underwater")
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--every", action="store_true")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    plates, meshes = files(given.plates, PLATES), files(given.meshes, MESHES)
    turn = itertools.cycle(meshes)
    right, shown, refused = 0, [], []
    for plate in plates:
        for mesh in meshes if given.every else [next(turn)]:
            if len(shown) >= given.pairs:
                break
            started, out = time.process_time(), given.out / f"{plate.stem}.{mesh.stem}.toml"
            try:
                made = make_first_scene(plate, mesh, out, overwrite=True)
            except Mr360uwError as error:
                refused.append(f"{plate.name}, {mesh.name}: {error}")
                continue
            lines = {line.split()[0]: line.split(maxsplit=1)[1] for line in made.lines}
            wet = "air" not in lines["where"].split(":")[0]
            same = wet == (given.water in str(plate.relative_to(given.plates)))
            right += same
            widest, high, low = seen(out)
            seconds = time.process_time() - started
            print(f"{plate.name} + {mesh.name}: {'water' if wet else 'air'} {'right' if same else 'WRONG'}, "
                  f"{widest:.0f} deg wide, from {low:.0f} to {high:.0f} deg, {seconds:.1f} s of processor")  # fmt: skip
            for name in ("where", "light", "water", "floor", "mesh", "size", "place", "note"):
                if name in lines:
                    print(f"    {name:<6}{lines[name]}")
            picture = cv2.resize(cv2.imread(str(made.preview)), SHOWN, interpolation=cv2.INTER_AREA)
            shown.append(cv2.putText(picture, out.stem, (6, 16), 0, 0.45, (0, 0, 255), 1))
    print(f"{right} of {len(shown)} plates told right; {len(refused)} refused")
    print("\n".join(f"refused: {line}" for line in refused))
    if shown:
        shown += [np.zeros_like(shown[0])] * (-len(shown) % 2)
        rows = [np.concatenate(shown[k : k + 2], axis=1) for k in range(0, len(shown), 2)]
        cv2.imwrite(str(given.out / "sheet.png"), np.concatenate(rows))


if __name__ == "__main__":
    main()
