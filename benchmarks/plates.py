# SPDX-License-Identifier: Apache-2.0
"""Water of real plates: what bodies far away become, whatever type of water is named.

    python benchmarks/plates.py FOOTAGE MESHES [--only NAME ...] [--out FOLDER] [--no-rims]

FOOTAGE and MESHES are folders, searched with all below them; what has "underwater" in its path is taken. Flat
photographs and clips are laid around the camera, mirrored, as panoramas. To these come three sample dives, graded. For
each plate `mr360uw new` writes a scene; in it, for the types IB, II, 1C and 5C, in the plate's freest open water near
the horizon, codes of 8 bits:

far: of a grey ball 120 m away, largest difference from the plate behind it in any channel.
spread: of a grey ball 6 m away, largest difference between two types with one visibility of 15 m.
moved: of the same ball, largest change from the type that `new` wrote, as its scene is.
rims: of bodies 6 to 30 m away, mean difference of their rim from the plate behind it; veil: of the veil alone, as of a
body of the same outline that is too far away to be seen.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import mr360uw as uw  # noqa: E402
from mr360uw.base.color import decode, encode, luminance  # noqa: E402
from mr360uw.errors import Mr360uwError  # noqa: E402
from mr360uw.first_look.first_scene import make_first_scene  # noqa: E402
from mr360uw.sample.dive_settings import DiveSettings  # noqa: E402
from mr360uw.scene.model import scene_from_dict  # noqa: E402
from mr360uw.scene.resolved import open_plate  # noqa: E402
from mr360uw.types import Floats  # noqa: E402

TYPES = ("IB", "II", "1C", "5C")
FAR, SPREAD, MOVED = 4.0, 15.0, 40.0
COLUMNS, RIM_COLUMNS = 1024, 512
BALL_DEG, BODY_DEG, ASIDE_DEG = 3.0, 10.0, 5.0
RIMS_M, BEYOND_M = (6.0, 12.0, 20.0, 30.0), 3000.0
VISIBILITY_M = 15.0
FLAT_FOV_DEG, PITCH_DEG = 90.0, {"reef_clip_gopro_hero10": -28.0}
"""Field of view of flat pictures, and the pitch of those that look down."""
PRESETS = ("reef", "blue", "green")
Table = dict[str, Any]


def around(picture: np.ndarray, pitch_deg: float, width: int = 2048) -> np.ndarray:
    """Return a flat picture (h, w, 3) as a panorama: mirrored around the camera, its edges drawn up and down.

    pitch_deg: of the picture's middle.
    """
    height, fov = width // 2, np.radians(FLAT_FOV_DEG)
    rows, columns = picture.shape[:2]
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 2.0 * np.pi
    turn = np.mod(longitude + 0.5 * fov, 2.0 * fov)
    turn = np.minimum(turn, 2.0 * fov - turn) - 0.5 * fov
    latitude = np.pi * (0.5 - (np.arange(height) + 0.5) / height) - np.radians(pitch_deg)
    lon, lat = np.meshgrid(turn, np.clip(latitude, -1.2, 1.2))
    focal = 0.5 * columns / np.tan(0.5 * fov)
    x = focal * np.tan(lon) + 0.5 * columns - 0.5
    y = 0.5 * rows - 0.5 - focal * np.tan(lat) / np.cos(lon)
    shown = cv2.remap(picture, x.astype(np.float32), np.clip(y, 0, rows - 1).astype(np.float32), cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_REPLICATE)  # fmt: skip
    beyond = np.clip(np.maximum(-y, y - rows + 1) / (0.5 * rows), 0.0, 1.0)[..., None]
    wide = np.concatenate([shown[:, -256:], shown, shown[:, :256]], axis=1)
    return np.asarray(shown * (1.0 - beyond) + cv2.GaussianBlur(wide, (0, 0), 60)[:, 256:-256] * beyond, np.uint8)


def graded(linear: Floats) -> Floats:
    """Return linear light with the grade of an edit: more contrast, more colour, warmer."""
    code = encode(np.clip(linear, 0.0, 1.0), "srgb")
    code = code + 0.6 * code * (1.0 - code) * (2.0 * code - 1.0)
    grey = luminance(code)[..., None]
    return np.asarray(decode(np.clip((grey + 1.25 * (code - grey)) * (1.05, 1.0, 0.95), 0.0, 1.0), "srgb"))


def plates(footage: Path, folder: Path) -> Iterator[Path]:
    """Yield plates under water as panoramas: as they are, or written into a folder."""
    for path in sorted(footage.rglob("*")):
        if "underwater" not in str(path.relative_to(footage)) or path.suffix not in (".jpg", ".mp4"):
            continue
        if "360" in path.parent.name:
            yield path
            continue
        flat = cv2.imread(str(path)) if path.suffix == ".jpg" else cv2.VideoCapture(str(path)).read()[1]
        out = folder / f"{path.stem}.png"
        cv2.imwrite(str(out), around(flat, PITCH_DEG.get(path.stem, 0.0)))
        yield out
    for preset in PRESETS:
        uw.sample_dive(folder / preset, DiveSettings.of(preset), width=COLUMNS, frames=1, overwrite=True)
        with uw.open_video(folder / preset / "dive.mp4") as video:
            shown = graded(next(iter(video.frames(0, 1))).image_linear)
        out = folder / f"{preset}_graded.png"
        cv2.imwrite(str(out), np.round(255.0 * encode(shown, "srgb"))[..., ::-1].astype(np.uint8))
        yield out


def open_direction(linear: Floats) -> tuple[float, float]:
    """Return azimuth and elevation [deg] of the smoothest, least red place at and below the horizon."""
    scale = linear.shape[0] / 180.0
    code = encode(np.maximum(linear, 0.0), "srgb").astype(np.float32)
    light = luminance(code)
    box = (round(6.0 * scale),) * 2
    mean, square = (cv2.blur(v, box) for v in (light, light * light))
    color = cv2.blur(code, box)
    cost = np.sqrt(np.maximum(square - mean * mean, 0.0)) + 0.3 * (color[..., 0] - color[..., 2])
    elevation = 90.0 - (np.arange(len(linear)) + 0.5) / scale
    cost[(elevation < -5.0) | (elevation > 0.5)] = np.inf
    row, column = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return (column + 0.5) / scale - 180.0, float(elevation[row])


def place(azimuth_deg: float, elevation_deg: float, distance_m: float) -> list[float]:
    """Return the position [m] of a direction at a distance."""
    a, e = np.radians([azimuth_deg, elevation_deg])
    return [float(distance_m * v) for v in (np.cos(e) * np.sin(a), np.sin(e), -np.cos(e) * np.cos(a))]


def near(shape: tuple[int, ...], azimuth_deg: float, elevation_deg: float, radius_deg: float) -> np.ndarray:
    """Return the mask (h, w) of a disc of directions."""
    ray = uw.sphere.directions(shape[1], shape[0])
    middle = np.array(place(azimuth_deg, elevation_deg, 1.0))
    return np.asarray(ray @ middle > np.cos(np.radians(radius_deg)))


def codes(linear: Floats) -> Floats:
    """Return 8-bit sRGB code values, not rounded."""
    return np.asarray(255.0 * encode(np.clip(linear, 0.0, 1.0), "srgb"))


class Case:
    """A plate, the scene that `new` wrote for it, and a direction of open water in it."""

    def __init__(self, plate: Path, ball: Path, folder: Path) -> None:
        written, _, _ = make_first_scene(plate, ball, folder / f"{plate.stem}.toml", overwrite=True)
        self.table: Table = tomllib.loads(written.read_text("utf-8"))
        self.folder, self.ball = folder, ball
        with open_plate(scene_from_dict(self.table, folder)) as video:
            self.whole = next(iter(video.frames(0, 1))).image_linear
        self.azimuth, self.elevation = open_direction(self.sized(COLUMNS))

    def sized(self, columns: int) -> Floats:
        """Return the plate's light at a width."""
        return np.asarray(cv2.resize(self.whole, (columns, columns // 2), interpolation=cv2.INTER_AREA), np.float32)

    def frame(self, objects: list[Table], columns: int, **water: Any) -> tuple[Floats, Floats]:
        """Return the composite and the layer's alpha of objects in the scene."""
        table = self.table | {"object": objects, "water": self.table["water"] | water}
        table["receiver"] = table.get("receiver", {"height_m": -2.0}) | {"shadow": False, "occlusion": False}
        frame = uw.render_frame(self.sized(columns), scene_from_dict(table, self.folder), backend="auto")
        alpha = np.zeros((columns // 2, columns))
        for tile in frame.layer.tiles:
            alpha[tile.window] = tile.alpha
        return np.asarray(frame.image_linear), alpha

    def grey(self, distance_m: float, aside_deg: float) -> Table:
        """Return a grey ball in open water."""
        size = 2.0 * distance_m * np.tan(np.radians(0.5 * BALL_DEG))
        where = place(self.azimuth + aside_deg, self.elevation, distance_m)
        return {"mesh": str(self.ball), "size_m": float(size), "position_m": where, "base_color": [0.4, 0.4, 0.4]}

    def balls(self, **water: Any) -> tuple[Floats, Floats, Floats]:
        """Return the mean codes (3,) of the plate, of a ball 120 m away before it, and of one 6 m away beside it."""
        picture, _ = self.frame([self.grey(120.0, 0.0), self.grey(6.0, ASIDE_DEG)], COLUMNS, **water)
        plate = self.sized(COLUMNS)
        far = near(plate.shape, self.azimuth, self.elevation, 0.35 * BALL_DEG)
        beside = near(plate.shape, self.azimuth + ASIDE_DEG, self.elevation, 0.35 * BALL_DEG)
        return codes(plate)[far].mean(axis=0), codes(picture)[far].mean(axis=0), codes(picture)[beside].mean(axis=0)

    def rim(self, mesh: Path, distance_m: float) -> Floats:
        """Return the mean difference (3,) in codes of the rim of a body from the plate behind it."""
        size = 2.0 * distance_m * np.tan(np.radians(0.5 * BODY_DEG))
        body = {"mesh": str(mesh), "size_m": float(size), "outside_files": True,
                "position_m": place(self.azimuth, self.elevation - 0.25 * BODY_DEG, distance_m)}  # fmt: skip
        picture, alpha = self.frame([body], RIM_COLUMNS)
        whole = (alpha > 0.99).astype(np.uint8)
        edge = (whole > 0) & (cv2.erode(whole, np.ones((5, 5), np.uint8)) == 0)
        difference = codes(picture)[edge] - codes(self.sized(RIM_COLUMNS))[edge]
        return difference.mean(axis=0) if len(difference) else np.full(3, np.nan)


def rows(case: Case) -> tuple[float, float, float]:
    """Print and return the far, spread and moved codes of a plate."""
    far, at_type = {}, {}
    for name in TYPES:
        plate, away, at_type[name] = case.balls(type=name)
        far[name] = float(np.abs(away - plate).max())
    _, _, own = case.balls()
    moved = {name: float(np.abs(at_type[name] - own).max()) for name in TYPES}
    try:
        one = np.array([case.balls(type=name, visibility_m=VISIBILITY_M)[2] for name in TYPES])
        spread = float(np.ptp(one, axis=0).max())
    except Mr360uwError:
        spread = float("nan")
    cells = "  ".join(f"{far[name]:5.1f} {moved[name]:5.1f}" for name in TYPES)
    water = case.table["water"]
    print(f"{cells}   {spread:5.1f}   {water['type']}, {water.get('visibility_m', '-')} m", flush=True)
    return max(far.values()), spread, max(moved.values())


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("footage", type=Path)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--no-rims", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) if given.out is None else given.out
        folder.mkdir(parents=True, exist_ok=True)
        ball = folder / "ball.ply"
        trimesh.creation.icosphere(4, 0.5).export(ball)
        meshes = sorted(path for path in given.meshes.rglob("*.glb"))[:2]
        found, cases = [], []
        print("codes                    " + "".join(f"{f'{n}: far, moved':>13s}" for n in TYPES) + "   spread  `new`")
        for plate in plates(given.footage, folder):
            if given.only and plate.stem not in given.only:
                continue
            case = Case(plate, ball, folder)
            cases.append((plate.stem, case))
            print(f"{plate.stem[:24]:24s} ", end="")
            found.append(rows(case))
        far, spread, moved = np.array(found).T
        for name, values, most in (("far", far, FAR), ("spread", spread, SPREAD), ("moved", moved, MOVED)):
            print(f"{name}: {np.sum(values <= most)} of {len(values)} plates within {most:g} codes, "
                  f"median {np.median(values):.1f}, largest {values.max():.1f}")  # fmt: skip
        if given.no_rims:
            return
        print("rims, mean difference of R, G, B from the plate")
        for name, case in cases:
            for mesh in meshes:
                cells = [f"{m:g} m " + " ".join(f"{v:4.0f}" for v in case.rim(mesh, m)) for m in RIMS_M]
                veil = " ".join(f"{v:4.0f}" for v in case.rim(mesh, BEYOND_M))
                print(f"{name[:24]:24s} {mesh.stem[:12]:12s} veil {veil}   {'   '.join(cells)}", flush=True)


if __name__ == "__main__":
    main()
