# SPDX-License-Identifier: Apache-2.0
"""Every picture of the README and the pages, made by the code as it is.

python docs/pictures.py [NAME ...]    # all of them without a name, a quarter of an hour on two cores

`venice.jpg` needs the panorama https://polyhaven.com/a/venice_sunset (CC0) as `build/venice_sunset*.hdr` or .exr.
"""

from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import mr360uw as uw  # noqa: E402
from mr360uw.base.sphere import direction_from_angles  # noqa: E402
from mr360uw.caustics import GerstnerSea, caustic_map  # noqa: E402
from mr360uw.from_above import AerialScene, aerial_film  # noqa: E402
from mr360uw.medium import JERLOV_TYPES, Medium, Sensor, Water  # noqa: E402
from mr360uw.preview.live import LivePreview  # noqa: E402
from mr360uw.preview.screen import look, perspective  # noqa: E402
from mr360uw.sample import Dive, DiveSettings, sample_dive  # noqa: E402
from mr360uw.sample.dive import with_noise, write_whale  # noqa: E402
from mr360uw.sample.dive_settings import PRESETS  # noqa: E402
from mr360uw.types import Floats  # noqa: E402
from samples.demo.pictures import VIEW, WIPE, first_view, picture, wiped  # noqa: E402

DOCS = ROOT / "docs"
DEMO = ROOT / "samples" / "demo"
WIDTH = 1600
LARGEST_BYTES = 400_000
"""Most that a page should make a reader load for one picture."""
_QUALITIES = (90, 85, 80, 75, 70, 60, 50, 40, 30)
_GAP = 6


DIVE = {
    "depth_m": 3.0, "floor_m": 7.0, "wind_m_s": 4.0, "sun_azimuth_deg": -125.0, "sun_elevation_deg": 52.0, "seed": 41,
    "solid": True, "sand_albedo": 0.48, "rocks": 0.03, "grass": 0.03, "stops": 2.5,
}  # fmt: skip
"""That of the demo's clip, see samples/demo/README.md."""
_EMPTY = (
    "shafts.mode=auto", "shafts.on_plate=true", "snow.amount=1", "object.0.visible=false",
    "object.0.casts_shadow=false",
)  # fmt: skip
"""Changes of the demo's scene that draw what is in the water of its plate."""


# --- the demo ------------------------------------------------------------------------------------------------------


def demo(folder: Path) -> Image.Image:
    """Return the demo's first frame, four thousand pixels around: the composite left of a line, the plate right."""
    dive = sample_dive(folder, DiveSettings.of(**DIVE), width=4096, frames=1, samples=2)
    dive.scene.write_bytes((DEMO / "scene.toml").read_bytes())
    uw.composite_video(uw.load_scene(dive.scene, _EMPTY), folder / "plate.mp4")
    (folder / "plate.mp4").replace(dive.plate)
    view = replace(VIEW, width=WIDTH, height=700)
    both = wiped(
        look(_composite(dive.scene, "draw.samples=65", "draw.sun_samples=24"), view), first_view(dive.plate, view)
    )
    return _named(picture(both), {(24, 20): "with a whale", (int(WIPE * WIDTH) + 24, 20): "as it was filmed"}, 40)


def loop(folder: Path) -> list[Image.Image]:
    """Return the demo as a loop at half its speed; its end fades into its start."""
    uw.composite_video(uw.load_scene(DEMO / "scene.toml"), folder / "loop.mp4")
    with uw.open_video(folder / "loop.mp4") as video:
        frames = [look(frame.image_linear, replace(VIEW, width=800, height=400)) for frame in video.frames()]
    fade = len(frames) // 4
    weights = (np.arange(fade) + 1.0) / (fade + 1.0)
    ends = [(1.0 - w) * a + w * b for w, a, b in zip(weights, frames[-fade:], frames[:fade], strict=True)]
    return [picture(frame) for frame in (*frames[fade:-fade], *ends)]


# --- real and other plates -----------------------------------------------------------------------------------------

_VENICE = """
[plate]
path = "plate.exr"
[water]
type = "none"
[receiver]
height_m = -1.7
[[object]]
mesh = "whale.glb"
azimuth_deg = -30.0
elevation_deg = -10.0
distance_m = 2.9
face = -120.0
"""


def venice(folder: Path) -> Image.Image:
    """Return a real panorama with a whale over the square."""
    found = [path for path in sorted((ROOT / "build").glob("venice_sunset*")) if path.suffix in (".hdr", ".exr")]
    if not found:
        raise SystemExit("venice.jpg - no panorama (got an empty build/) - get polyhaven.com/a/venice_sunset as .hdr")
    with uw.open_video(found[0]) as still:
        light = next(still.frames()).image_linear
    # Twice as large, across its seam, for an edge of the whale that is finer than the map
    around = cv2.copyMakeBorder(light, 0, 0, 1, 1, cv2.BORDER_WRAP)
    wide = cv2.resize(around, None, fx=2, fy=2)[:, 2:-2]
    uw.video.write_exr(folder / "plate.exr", np.ascontiguousarray(wide))
    write_whale(folder / "whale.glb", 4.5)
    (folder / "scene.toml").write_text(_VENICE, "utf-8")
    return picture(_composite(folder / "scene.toml")[180:880])


def presets(_: Path) -> Image.Image:
    """Return a frame of every preset of the sample dive, and of the dive without any."""
    tiles = []
    for name in (*PRESETS, None):
        settings = DiveSettings.of(name)
        light = Dive(settings, 800, 400, samples=2).radiance(1.0)
        noisy = with_noise(light, settings.noise, settings.seed, 0)
        tiles.append(_named(picture(noisy), {(16, 366): name or "without a preset"}))
    return sheet(tiles, 2)


_TORCH = (
    "lamp=[{position_m=[0.8, 0.4, -0.5], rotation_deg=[25, -12, 0], lumen=9000, cone_deg=24}]",
    "light.white_cd_m2=200",
)


def shafts(folder: Path) -> Image.Image:
    """Return a dive with shafts of its waves three times as strong as they are, and with the beam of a torch."""
    scene = sample_dive(
        folder, DiveSettings(depth_m=6.0, floor_m=9.5, water="II", stops=1.0), width=3072, frames=2
    ).scene
    sides = [_composite(scene, *sets, frame=1) for sets in (("shafts.on_plate=true", "shafts.strength=3"), _TORCH)]
    view = perspective(yaw_deg=18.0, pitch_deg=10.0, fov_deg=95.0, width=800, height=600)
    return sheet([picture(look(side, view)) for side in sides], 2)


_FLOATING = """
[surface]
objects = "auto"
[[object]]
mesh = "ball.ply"
position_m = [-2.0, 3.0, -6.5]
base_color = [0.95, 0.7, 0.05]
[[object]]
mesh = "boat.ply"
attach = "surface"
position_m = [1.3, 0.15, -3.9]
rotation_deg = [25.0, 0.0, 0.0]
base_color = [0.85, 0.3, 0.15]
"""


def at_the_surface(folder: Path) -> Image.Image:
    """Return a ball below and a boat across the surface of a dive, without their images in it and with them."""
    dive = sample_dive(folder, DiveSettings(depth_m=4.0, wind_m_s=3.0, stops=1.0), width=4096, frames=1)
    trimesh.creation.icosphere(4, 0.45).export(folder / "ball.ply")
    trimesh.creation.box((1.2, 0.7, 2.4)).export(folder / "boat.ply")
    head = dive.scene.read_text("utf-8").split("[[object]]")[0]
    dive.scene.write_text(head + _FLOATING, "utf-8")
    view = perspective(yaw_deg=0.0, pitch_deg=36.0, fov_deg=75.0, width=800, height=500)
    sides = [look(_composite(dive.scene, f'surface.objects="{objects}"'), view) for objects in ("none", "auto")]
    return sheet([picture(side) for side in sides], 2)


def surface(_: Path) -> Image.Image:
    """Return the same sea from 1.5 m below and from 3 m above it."""
    settings = DiveSettings(depth_m=1.5, floor_m=6.0, wind_m_s=5.0, sun_elevation_deg=50.0, sun_azimuth_deg=20.0)
    rows = []
    for lift_m, stops in ((0.0, 0.5), (4.5, 1.0)):
        dive = Dive(settings, WIDTH, WIDTH // 2)
        view = settings.view(WIDTH, WIDTH // 2, 0.0)
        view = replace(view, position=view.position + np.array([0.0, lift_m, 0.0]))
        seen = dive.scene.picture(view, 0.0, samples=2).radiance
        rows.append(picture(2.0**stops * dive.exposure * seen[WIDTH // 8 : 3 * WIDTH // 8]))
    return sheet(rows, 1)


# --- from above ----------------------------------------------------------------------------------------------------

_CALM: Mapping[str, Any] = {"tile_m": 12.0, "shortest_wavelength_m": 0.14, "wind_speed": 2.0, "detail_slope": 0.03}
_AERIAL: Mapping[str, Mapping[str, Any]] = {
    "calm, sun high": {"sea": _CALM, "floor": {"depth_m": 2.5}, "camera": {"position_m": (0.0, 5.0, 0.0)}},
    "wind 8 m/s, sun low ahead": {
        "sea": {"wind_speed": 8.0, "tile_m": 60.0, "resolution": 512, "shortest_wavelength_m": 0.6},
        "sun": {"elevation_deg": 25.0, "azimuth_deg": 10.0}, "floor": {"depth_m": 6.0},
        "camera": {"position_m": (0.0, 20.0, 0.0), "pitch_deg": -25.0, "exposure": 0.7},
    },
    "a whale under the waves": {
        "sea": _CALM, "floor": {"depth_m": 4.0}, "camera": {"position_m": (0.0, 8.0, 0.0), "pitch_deg": -60.0},
        "object": [{"mesh": "whale.glb", "position_m": (0.0, -1.5, -4.5), "face": 60.0}],
    },
    "wind 5 m/s, from 60 m": {
        "sea": {"wind_speed": 5.0, "tile_m": 100.0, "resolution": 512, "shortest_wavelength_m": 0.6},
        "floor": {"depth_m": 5.0, "tile_m": 24.0}, "sun": {"elevation_deg": 45.0},
        "camera": {"position_m": (0.0, 60.0, 0.0), "pitch_deg": -70.0},
    },
}  # fmt: skip


def aerial(folder: Path) -> Image.Image:
    """Return four seas as a camera in the air sees them."""
    write_whale(folder / "whale.glb", 4.0)
    tiles = []
    for number, (name, tables) in enumerate(_AERIAL.items()):
        camera = {**tables["camera"], "width": 800, "height": 450}
        objects = [{**one, "mesh": folder / one["mesh"]} for one in tables.get("object", [])]
        scene = AerialScene.model_validate({**tables, "camera": camera, "object": objects, "film": {"samples": 3}})
        aerial_film(scene, folder / f"{number}.png")
        tiles.append(_named(Image.open(folder / f"{number}.png").convert("RGB"), {(16, 416): name}))
    return sheet(tiles, 2)


# --- light and water -----------------------------------------------------------------------------------------------

_AMBIENT = """
[plate]
path = "plate.exr"
[water]
type = "none"
[light]
sun = "none"
[receiver]
height_m = -1.2
[[object]]
mesh = "crate.ply"
position_m = [-0.35, -0.8, -2.4]
rotation_deg = [25.0, 0.0, 0.0]
base_color = [0.8, 0.12, 0.08]
[[object]]
mesh = "ball.ply"
position_m = [0.45, -0.85, -2.2]
base_color = [0.75, 0.75, 0.75]
"""


def ambient(folder: Path) -> Image.Image:
    """Return two bodies alone, then together, then with the floor, what that changes, and what the crate sends."""
    sky = np.ones((1024, 2048, 3), np.float32)
    sky[512:] = 0.35
    uw.video.write_exr(folder / "plate.exr", sky)
    trimesh.creation.box((0.8, 0.8, 0.8)).export(folder / "crate.ply")
    trimesh.creation.icosphere(4, 0.35).export(folder / "ball.ply")
    (folder / "scene.toml").write_text(_AMBIENT, "utf-8")
    view = perspective(yaw_deg=0.0, pitch_deg=-22.0, fov_deg=50.0, width=400, height=300)

    def seen(*sets: str) -> Floats:
        return look(_composite(folder / "scene.toml", *sets), view)

    alone = seen("draw.ambient_occlusion=false", "receiver.occlusion=false")
    bare_floor, whole = seen("receiver.occlusion=false"), seen()
    sent = np.abs(whole - seen("object.0.base_color=[0.0,0.0,0.0]"))
    return sheet([picture(one) for one in (alone, bare_floor, whole, 0.5 + 0.5 * (whole - alone), 4.0 * sent)], 5)


def caustics(_: Path) -> Image.Image:
    """Return light on level floors by wind and depth, the sun 30 degrees from the zenith; 4 is white."""
    sun = direction_from_angles(0.0, np.radians(60.0))
    tiles = []
    for wind in (1.5, 4.0, 10.0):
        for depth in (1.0, 3.0, 8.0, 20.0):
            ratio = caustic_map(GerstnerSea(wind_speed=wind), tuple(sun), depth, 0.0, 400, 256)
            grey = picture(np.repeat(ratio[..., None] / 4.0, 3, axis=2))
            tiles.append(_named(grey, {(12, 364): f"wind {wind:g} m/s, {depth:g} m deep"}))
    return sheet(tiles, 4)


def waters(_: Path) -> Image.Image:
    """Return level views in ten waters at four depths, grey balls at 2, 4 and 8 m, each exposed for itself."""
    width, height = 160, 120
    directions = perspective(fov_deg=100.0, width=width, height=height).pixel_directions()
    tiles = []
    for depth in (1.0, 4.0, 10.0, 20.0):
        for name in JERLOV_TYPES:
            medium = Medium(Water.jerlov(name), Sensor.cie1931(), "table", depth)
            light = medium.light.display(_with_balls(medium, depth, directions))
            level = np.percentile(light.max(axis=-1), 80)
            tiles.append(_named(picture(0.7 * light / level), {(6, 96): f"{name}, {depth:g} m"}, 15))
    return sheet(tiles, len(JERLOV_TYPES), gap=0)


def _with_balls(medium: Medium, depth_m: float, directions: Floats) -> Floats:
    """Return the radiance of open water and grey balls in directions (H, W, 3)."""
    up = directions[..., 1]
    light = medium.model.radiance(depth_m, up)
    for azimuth, distance, radius in ((-0.55, 2.0, 0.5), (0.0, 4.0, 0.9), (0.5, 8.0, 1.6)):
        # Nearest intersection of rays with the ball
        axis = np.array([np.sin(azimuth), 0.0, -np.cos(azimuth)])
        inside = directions @ axis > np.sqrt(1.0 - (radius / distance) ** 2)
        middle = distance * (directions @ axis)[inside]
        near = middle - np.sqrt(np.maximum(middle**2 - distance**2 + radius**2, 0.0))
        normal = (near[:, None] * directions[inside] - distance * axis) / radius
        # Its light of albedo 0.3 through the water, and the water's own before it
        at = np.maximum(depth_m - near * up[inside], 0.0)
        own = 0.3 / np.pi * medium.model.irradiance(at, normal[:, 1]) * medium.spectral_transmittance(near)
        light[inside] = own + medium.model.inscatter(near, depth_m, up[inside])
    return light


def tuning(folder: Path) -> Image.Image:
    """Return the tuning page in a browser, with keys and the plate behind a divider."""
    from benchmarks.tune import rest, tuned

    settings = DiveSettings(depth_m=2.5, floor_m=5.5, sun_azimuth_deg=-85.0, sand_albedo=0.45, rocks=0.01, stops=1.5)
    scene = sample_dive(folder, settings, width=2048, frames=24).scene
    with tuned(scene, (WIDTH, 900), "light") as (page, *_):
        rest(page)
        page.get_by_label("key Wind speed at this time").click()
        page.locator(".uw-strip").press("End")
        page.get_by_label("Wind speed", exact=True).fill("9")
        page.get_by_label("Wind speed", exact=True).press("Enter")
        page.locator(".uw-key").nth(1).wait_for()
        page.get_by_label("Width of the full picture").select_option("2048")
        page.get_by_label("Compare with", exact=True).select_option("plate")
        page.locator(".segments").get_by_role("button", name="All").click()
        page.locator("summary", has_text="Sea surface").click()
        rest(page)
        page.wait_for_timeout(4000)  # thumbnails
        return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


PICTURES: Mapping[str, Callable[[Path], Image.Image | list[Image.Image]]] = {
    "demo.jpg": demo,
    "demo.webp": loop,
    "venice.jpg": venice,
    "presets.jpg": presets,
    "shafts.jpg": shafts,
    "at_the_surface.jpg": at_the_surface,
    "surface.jpg": surface,
    "aerial.jpg": aerial,
    "ambient.jpg": ambient,
    "caustics.jpg": caustics,
    "waters.jpg": waters,
    "tuning.jpg": tuning,
}
"""What makes each picture, given an empty folder; a list is a loop."""


# --- light to files ------------------------------------------------------------------------------------------------


def sheet(tiles: list[Image.Image], columns: int, gap: int = _GAP) -> Image.Image:
    """Return tiles of one size in rows, with gaps between them, at least `WIDTH` across."""
    width, height = tiles[0].size
    rows = -(-len(tiles) // columns)
    made = Image.new("RGB", (columns * (width + gap) - gap, rows * (height + gap) - gap), "white")
    for k, tile in enumerate(tiles):
        made.paste(tile, (k % columns * (width + gap), k // columns * (height + gap)))
    return made


def save(name: str, made: Image.Image | list[Image.Image]) -> None:
    """Write a picture or a loop into docs, at the best quality with which it is small enough."""
    first, *others = made if isinstance(made, list) else [made]
    moves: dict[str, Any] = {"save_all": True, "append_images": others, "duration": 83, "loop": 0} if others else {}
    for quality in _QUALITIES:
        data = io.BytesIO()
        first.save(data, Image.registered_extensions()[Path(name).suffix], quality=quality, **moves)
        if len(data.getvalue()) < LARGEST_BYTES:
            (DOCS / name).write_bytes(data.getvalue())
            size = f"{first.width} x {first.height}, {len(data.getvalue()) / 1e3:.0f} kB, quality {quality}"
            print(f"docs/{name}: {size}", flush=True)
            return
    raise SystemExit(f"{name} - is too large at any quality (got {len(data.getvalue())} bytes) - show less")


def _composite(scene: Path, *sets: str, frame: int = 0) -> Floats:
    with LivePreview("gl") as live:
        return live.frame(uw.load_scene(scene, sets), frame).picture.image_linear


def _named(image: Image.Image, names: Mapping[tuple[int, int], str], size: float = 22) -> Image.Image:
    """Return a picture with words at (x, y), white with a dark edge."""
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(size)
    for place, words in names.items():
        pen.text(place, words, "white", font, stroke_width=2, stroke_fill=(0, 0, 0, 128))
    return image


def main() -> None:
    """Make the pictures that are named, or all."""
    wanted = sys.argv[1:] or list(PICTURES)
    if unknown := [name for name in wanted if name not in PICTURES]:
        sys.exit(f"{', '.join(unknown)} - no such picture - choose from {', '.join(PICTURES)}")
    for name in wanted:
        with tempfile.TemporaryDirectory() as folder:
            save(name, PICTURES[name](Path(folder)))


if __name__ == "__main__":
    main()
