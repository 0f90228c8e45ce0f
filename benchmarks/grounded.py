# SPDX-License-Identifier: Apache-2.0
"""Bodies on the ground against truth from outside: occlusion, light between bodies and ground, contact, shadows on a
plate's own caustics, cost.

    python benchmarks/grounded.py [truth [SCENE ...] | defaults [SCENE ...] | contact | furnace | caustics [WATER ...] |
                                   speed [CHECKOUT] | pictures FOLDER]

`truth`, `defaults` and `pictures` need Mitsuba 3 (`pip install 'mr360uw[peers]'`; see peers/path_traced.py) and render
for some minutes at the first time. `speed` with another checkout of the project measures both, in turns.
"""

from __future__ import annotations

import itertools
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
if sys.argv[1:2] == ["measure"]:
    sys.path.insert(0, sys.argv[2])
    import mr360uw  # noqa: F401  # of that checkout; its modules follow, scenes and tests are those beside this program
sys.path.insert(0, str(ROOT))

from benchmarks.peers.mitsuba_scene import has_mitsuba  # noqa: E402
from benchmarks.peers.path_traced import Truth  # noqa: E402
from benchmarks.peers.path_traced import truth as traced  # noqa: E402
from benchmarks.peers.scene_files import FINER, KINDS, WHITE, composited, tables, write_files  # noqa: E402
from benchmarks.peers.scenes import (  # noqa: E402
    FLOOR_ALBEDO,
    FLOOR_Y_M,
    SCENES,
    SKIES,
    WIDTH,
    Scene,
    Sky,
    crate,
    diffuse,
    lights,
    torus,
)
from mr360uw.composite import PlacedObject, Receiver, Shot, render_layer  # noqa: E402
from mr360uw.composite.gl.layer_renderer import LayerRenderer  # noqa: E402
from mr360uw.composite.tiles import over  # noqa: E402
from mr360uw.ibl.lookup import environment_lookup  # noqa: E402
from mr360uw.types import Environment, Floats, Layer, View  # noqa: E402
from tests.composite.form_factors import box_form_factor, sphere_form_factor  # noqa: E402
from tests.composite.scenes import box, codes, environment, placed, sphere  # noqa: E402

Render = Callable[[Shot], Layer]
UP = np.array([0.0, 1.0, 0.0])


def renderers() -> dict[str, Render]:
    """Return both renderers."""
    return {"reference": render_layer, "gl": LayerRenderer().render}


# --- against the path tracer ---------------------------------------------------------------------------------------

TARGETS = {
    "objects": (0.03, 0.05),
    "inside": (0.06, 0.06),
    "floor": (0.02, 0.03),
    "floor*": (0.02, 0.03),
    "umbra": (0.05, 0.08),
}
"""Largest relative RMSE of (reference, gl)."""
CHANGED = 0.02
"""Relative change of the plate, as the mean of 5 x 5 pixels, from which on the floor counts as changed: that mean has a
noise of 0.005 at most. Single pixels would be chosen by their noise."""
DARK = 0.01
"""Visible fraction of the sun's disc below which a pixel of the floor lies in the umbra."""
WHOLE = 0.999


def regions(scene: Scene, found: Truth, plate: Floats) -> dict[str, np.ndarray]:
    """Return which pixels (H, W) are compared under each name."""
    objects = found.valid & (found.shape > WHOLE).any(axis=0)
    floor = found.valid & (found.floor > WHOLE)
    changed = floor & (_blurred_change(found, plate, floor) > CHANGED)
    lit = np.where(floor, found.sunlit, 1.0)
    same = ~floor | (_spread(lit, np.maximum) - _spread(lit, np.minimum) < DARK)
    where = {"objects": objects, "floor": changed, "umbra": floor & (found.sunlit < DARK)}
    if not np.all(same):
        where["floor*"] = changed & same
    if scene.inside is not None:
        where["inside"] = objects & np.all((found.point > scene.inside[0]) & (found.point < scene.inside[1]), axis=-1)
    return {name: where[name] for name in TARGETS if name in where and np.any(where[name])}


def _spread(values: Floats, extreme: np.ufunc) -> Floats:
    """Return the largest or smallest of 3 x 3 pixels."""
    for axis in (0, 1):
        values = extreme(values, extreme(np.roll(values, 1, axis), np.roll(values, -1, axis)))
    return values


def _blurred_change(found: Truth, plate: Floats, floor: np.ndarray) -> Floats:
    """Return the relative change of the floor (H, W), the mean over the 5 x 5 pixels around that show the floor."""
    import cv2

    change = np.where(floor, (np.nan_to_num(found.mean) / plate - 1.0).mean(axis=-1), 0.0)
    total, count = (cv2.boxFilter(a.astype(np.float64), -1, (5, 5), normalize=False) for a in (change, floor))
    return np.abs(total / np.maximum(count, 1.0))


def errors(image: Floats, found: Truth, where: np.ndarray) -> tuple[float, float]:
    """Return (RMSE, mean error) of an image in some pixels, over all channels, both relative to the mean of the truth.

    The truth's noise is not in the RMSE: errors against two independent halves are multiplied, not squared.
    """
    a, b = (image[where] - half[where] for half in found.halves.astype(np.float64))
    level = float(found.mean[where].mean())
    return float(np.sqrt(max(np.mean(a * b), 0.0))) / level, float(np.mean(a + b)) / (2.0 * level)


def noise(found: Truth, where: np.ndarray) -> float:
    """Return the standard deviation of the truth's pixels, relative to their mean."""
    half = (found.halves[0] - found.halves[1])[where] / 2.0
    return float(np.sqrt(np.mean(half**2))) / float(found.mean[where].mean())


def truth(*names: str) -> None:
    """Relative RMSE and, in brackets, mean error against the path tracer.

    known: lit by exactly the sky and the sun that the truth has. plate: by what is measured in the plate. floor: all
    that changes; floor*: without the edge of the sun's shadow, some three pixels wide.
    """
    both = renderers()
    columns = [f"{name} {light}" for name in both for light in ("known", "plate")]
    print(f"{'scene':9} {'sky':8} {'region':7} {'pixels':>6} {'noise':>6} " + "".join(f"{c:>19}" for c in columns))
    seconds = 0.0
    for scene in (SCENES[name] for name in names or SCENES):
        for sky in SKIES.values():
            found, plate = traced(scene, sky), scene.plate(sky)
            light = lights(sky, scene.paving_m)
            seconds += float(found.seconds)
            images = [over(plate, render(scene.shot(light[k]))) for render in both.values() for k in ("known", "plate")]
            for region, where in regions(scene, found, plate).items():
                cells = "".join("{:10.4f} ({:+.3f})".format(*errors(image, found, where)) for image in images)
                target = "{} / {}".format(*TARGETS[region])
                start = f"{scene.name:9} {sky.name:8} {region:7} {where.sum():6} {noise(found, where):6.4f} "
                print(f"{start}{cells}   target {target}")
    print(f"the path tracer took {seconds:.0f} s of processor time for these pictures")


def defaults(*names: str, folder: str | None = None) -> None:
    """Composites of files by the program's defaults against the path tracer: largest relative error of a mean.

    found: the program finds the sun; told: it is told where the sun is and, for 8 bit, its share of the light. Means
    are over the inner pixels of each body, over the umbra and over the penumbra on the floor, in each channel: the
    worst of them is shown. Highlights that 8 bits cannot show are left out. pixels: relative RMSE of the metal's
    pixels, see `truth`. folder: for pictures, truth and composites side by side.
    """
    print(
        f"{'scene':9} {'sky':8} {'plate':6} {'renderer':9} {'light':6}"
        + "".join(f"{r:>10}" for r in (*MEANS, "pixels"))
    )
    for scene in (SCENES[name] for name in names or SCENES):
        for sky in SKIES.values():
            found = traced(scene, sky)
            parts = _parts(scene, found)
            with TemporaryDirectory() as files:
                write_files(scene, sky, Path(files), FINER * WIDTH)
                for kind, backend, light in itertools.product(KINDS, ("reference", "gl"), ("found", "told")):
                    shown = found.mean.max(axis=-1) < WHITE[kind]
                    where = {name: [one & shown for one in some] for name, some in parts.items()}
                    data = tables(scene, sky, kind, told=light == "told")
                    image = composited(Path(files), data, backend, WIDTH)
                    cells = "".join(_worst(image, found.mean, where.get(region, [])) for region in MEANS)
                    cells += _rms(image, found, where.get("metal", []))
                    print(f"{scene.name:9} {sky.name:8} {kind:6} {backend:9} {light:6}{cells}", flush=True)
                    if folder is not None and backend == "reference":
                        _show(Path(folder) / f"{scene.name}-{sky.name}-{kind[0]}-{light}.png", found, image, sky)
    print("target:" + " " * 35 + "".join(f"{limit:10.2f}" for limit in (*MEANS.values(), _METAL)))


MEANS = {"objects": 0.05, "metal": 0.06, "umbra": 0.08, "penumbra": 0.08}
"""Largest relative error of a mean in each channel."""
_METAL = 0.06
"""Largest relative RMSE of metal."""
_FEWEST = 20
"""Pixels below which a part has no mean to speak of."""


def _parts(scene: Scene, found: Truth) -> dict[str, list[np.ndarray]]:
    """Return the parts (H, W) of a picture whose means are compared, by their kind."""
    parts: dict[str, list[np.ndarray]] = {}
    for body, shape in zip(scene.bodies, found.shape, strict=True):
        kind = "metal" if body.mesh.materials[0].metallic == 1.0 else "objects"
        parts.setdefault(kind, []).append(found.valid & (shape > WHOLE))
    floor = found.valid & (found.floor > WHOLE)
    parts["umbra"] = [floor & (found.sunlit < DARK)]
    parts["penumbra"] = [floor & (found.sunlit >= DARK) & (found.sunlit < 1.0 - DARK)]
    return {kind: [one for one in some if one.sum() >= _FEWEST] for kind, some in parts.items()}


def _worst(image: Floats, true: Floats, parts: list[np.ndarray]) -> str:
    """Return the relative error that is largest of the means of parts of an image, with its sign."""
    errors = [image[one].mean(axis=0) / true[one].mean(axis=0) - 1.0 for one in parts]
    return f"{max(np.ravel(errors), key=abs):+10.3f}" if errors else f"{'-':>10}"


def _rms(image: Floats, found: Truth, parts: list[np.ndarray]) -> str:
    """Return the relative RMSE of an image over all pixels of parts."""
    return f"{errors(image, found, np.any(parts, axis=0))[0]:10.3f}" if parts else f"{'-':>10}"


def _show(path: Path, found: Truth, image: Floats, sky: Sky) -> None:
    """Write truth, a composite, and five times their difference about grey, side by side."""
    import cv2

    rows, columns = (np.flatnonzero(found.valid.any(axis=k)) for k in (1, 0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    shown = [codes(one[window] * (0.4 / sky.floor_radiance.mean())) for one in (np.nan_to_num(found.mean), image)]
    shown.append(127.5 + 5.0 * np.where(found.valid[window][..., None], shown[1] - shown[0], 0.0))
    sheet = np.concatenate([np.repeat(np.repeat(one, 4, 0), 4, 1) for one in shown], axis=1)
    cv2.imwrite(str(path), np.clip(sheet, 0, 255).astype(np.uint8)[..., ::-1])


def pictures(folder: str) -> None:
    """Write truth, reference, gl, and the errors of the two times five about grey, of every scene, side by side."""
    import cv2

    both = renderers()
    for scene in SCENES.values():
        for sky in SKIES.values():
            found, plate = traced(scene, sky), scene.plate(sky)
            rows, columns = (np.flatnonzero(found.valid.any(axis=k)) for k in (1, 0))
            window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
            light = lights(sky, scene.paving_m)["known"]
            images = [np.nan_to_num(found.mean), *(over(plate, render(scene.shot(light))) for render in both.values())]
            shown = [codes(image[window] * (0.4 / sky.floor_radiance.mean())) for image in images]
            valid = found.valid[window][..., None]
            shown += [127.5 + 5.0 * np.where(valid, image - shown[0], 0.0) for image in shown[1:3]]
            sheet = np.concatenate([np.repeat(np.repeat(image, 4, 0), 4, 1) for image in shown], axis=1)
            path = Path(folder) / f"{scene.name}-{sky.name}.png"
            cv2.imwrite(str(path), np.clip(sheet, 0, 255).astype(np.uint8)[..., ::-1])


# --- contact -------------------------------------------------------------------------------------------------------

_RADIUS_M, _PLANE_M, _AWAY_M = 0.3, -1.5, -0.9
_NEAR = 0.099
"""Points nearer to a body than this many radii are its contact."""
_EDGE_M = 0.02
"""Distance from the outline of a box that lies flat within which the blocked light jumps between two pixels."""
_RISE = 0.002
"""Largest rise away from a body that is not counted as a local maximum: bilinear samples of single floats."""


@dataclass(frozen=True, slots=True)
class _Case:
    """A body over a plane under a uniform sky. blocked: exact fraction at points (n, 3). distance_m: to the body."""

    name: str
    gap: float
    body: PlacedObject
    blocked: Callable[[Floats], Floats]
    distance_m: Callable[[Floats], Floats]
    low: Floats | None = None
    high: Floats | None = None


def _cases() -> Iterator[_Case]:
    black = diffuse((0.0, 0.0, 0.0))
    for gap in (0.0, 0.1, 0.5, 1.0):
        center = np.array([0.0, _PLANE_M + _RADIUS_M * (1.0 + gap), _AWAY_M])
        yield _Case(
            "sphere", gap, placed(sphere(48, black, _RADIUS_M), tuple(center)),
            lambda p, c=center: sphere_form_factor(p, UP, c, _RADIUS_M),
            lambda p, c=center: np.linalg.norm(p - c, axis=-1) - _RADIUS_M,
        )  # fmt: skip
        for name, height in (("box", 2.0 * _RADIUS_M), ("plate", 0.02 * _RADIUS_M)):
            size = np.array([2.0 * _RADIUS_M, height, 2.0 * _RADIUS_M])
            center = np.array([0.0, _PLANE_M + _RADIUS_M * gap + 0.5 * height, _AWAY_M])
            low, high = center - 0.5 * size, center + 0.5 * size
            low[1] = max(low[1], _PLANE_M + 1e-6 * _RADIUS_M)  # its lower face is still above the plane
            yield _Case(
                name, gap, placed(box(tuple(size), black), tuple(center)),
                lambda p, a=low, b=high: np.array([box_form_factor(q, UP, a, b) for q in p]),
                lambda p, a=low, b=high: np.linalg.norm(p - np.clip(p, a, b), axis=-1), low, high,
            )  # fmt: skip


def contact() -> None:
    """Blocked fraction of a uniform sky's light on a plane: largest errors, and the largest rise along a radius.

    everywhere: all but the contact, the points nearer than a tenth of the radius. rise: how much more light is blocked
    farther from the middle than nearer to it, where the closed form has less.
    """
    white, azimuth = environment(1.0), np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    radius = np.arange(0.01, 5.0, 0.02) * _RADIUS_M
    around = np.stack([np.sin(azimuth), np.zeros_like(azimuth), np.cos(azimuth)], axis=-1)
    points = np.array([0.0, _PLANE_M, _AWAY_M]) + radius[:, None, None] * around
    both = renderers()
    print(f"{'body':7} {'gap':>4} " + "".join(f"{name:>11}: everywhere  contact     rise" for name in both))
    for case in _cases():
        flat = points.reshape(-1, 3)
        exact, near = case.blocked(flat), case.distance_m(flat) < _NEAR * _RADIUS_M
        smooth = np.ones(len(flat), bool)
        if case.gap == 0.0 and case.low is not None:
            outside = np.max(np.maximum(case.low - flat, flat - case.high)[:, [0, 2]], axis=-1)
            smooth = np.abs(outside) > _EDGE_M
        cells = ""
        for render in both.values():
            view, body = View(1024, 512), replace(case.body, visible=False)
            layer = render(Shot(view, (body,), white, receiver=Receiver(plane_y=_PLANE_M)))
            blocked = 1.0 - environment_lookup(layer.ratio, flat)[:, 1]
            error = np.abs(blocked - exact)
            at_contact = f"{error[near & smooth].max():8.4f}" if np.any(near & smooth) else f"{'-':>8}"
            rise = np.diff(blocked.reshape(points.shape[:2]), axis=0).max()
            cells += f"{error[~near & smooth].max():23.4f} {at_contact} {rise:8.4f}{' ' if rise < _RISE else '!'}"
        print(f"{case.name:7} {case.gap:4} {cells}   target 0.02, 0.05, {_RISE}")


# --- limits --------------------------------------------------------------------------------------------------------


def furnace() -> None:
    """White bodies in white light vanish; so does a card of the floor's colour that lies on the floor."""
    both, white = renderers(), diffuse((1.0, 1.0, 1.0))
    bodies = {
        "ball": (placed(sphere(32, white), (0.0, -0.3, -1.5)),),
        "torus": (placed(torus(0.4, 0.14, white), (0.0, -0.5, -1.2)),),
        "crate": (placed(crate((0.9, 0.4, 0.7), 0.04, white), (0.0, -0.8, -1.0)),),
        "two balls": tuple(placed(sphere(32, white), (x, -0.3, -1.8)) for x in (-0.5, 0.5)),
    }
    print("largest relative difference from the background (target: 0.005, on a white floor as the floor's 0.02, 0.03)")
    for name, things in bodies.items():
        for floor in (None, Receiver(plane_y=-1.0)):
            shot = Shot(View(256, 128), things, environment(0.5), receiver=floor)
            worst = {
                key: np.abs(over(np.full((128, 256, 3), 0.5, np.float32), render(shot)) / 0.5 - 1.0).max()
                for key, render in both.items()
            }
            where = "in the air" if floor is None else "over a white floor"
            print(f"  {name:10} {where:19} " + "   ".join(f"{key} {value:.5f}" for key, value in worst.items()))
    paint = diffuse(tuple(map(float, FLOOR_ALBEDO)))
    for sky in SKIES.values():
        plate = sky.plate()
        for thickness_m in (1e-3, 1e-4):  # its side face is seen too, and has light of its own
            card = placed(box((0.8, thickness_m, 0.6), paint), (0.0, FLOOR_Y_M + 0.5 * thickness_m, -1.3))
            shot = Shot(
                View(WIDTH, WIDTH // 2), (card,), lights(sky)["known"], tuple(filter(None, [sky.sun])),
                receiver=Receiver(plane_y=FLOOR_Y_M),
            )  # fmt: skip
            worst = {key: np.abs(over(plate, render(shot)) / plate - 1.0).max() for key, render in both.items()}
            found = "   ".join(f"{key} {value:.5f}" for key, value in worst.items())
            print(f"  flush card, {1e3 * thickness_m:.1f} mm, {sky.name:13} {found}")


# --- the plate's own caustics --------------------------------------------------------------------------------------

DIVES = [(water, depth, up) for water in ("IA", "II", "1C") for depth in (4.0, 8.0) for up in (35.0, 60.0)]
_SHOWN = 5
"""Frames of a dive that are compared."""


def caustics(*waters: str) -> None:
    """Umbra of a ball on synthetic dives under moving caustics, against the dive's own picture with the ball's shade.

    plate: contrast of the caustics in the plate. left: contrast of what is wrong in the umbra as a fraction of it, the
    mean of five frames; in brackets with the caustics left as they are. mean: light in the umbra over the dive's own,
    red, green, blue. texture: correlation of the sand's albedo with that in the umbra. clip: ten seconds, cut: two,
    still: one frame, all lit by the dive's own light; measured: ten seconds, lit by what is measured in the plate.
    """
    from benchmarks.peers.shaded_dives import CLIPS, FRAMES, ShadedDive, remains

    render = renderers()["gl"]
    print("water m deg floor  shown     plate  left (keep)   mean                 texture (keep)")
    for (water, depth_m, up_deg), contrast in itertools.product(DIVES, (1.0, 0.0)):
        if waters and water not in waters:
            continue
        dive = ShadedDive.of(water, depth_m, up_deg, contrast)
        clip = [dive.frame(index) for index in FRAMES]
        analysis = {count: dive.analysis(clip[:count]) for count in set(CLIPS.values()) - {1}}
        for name, count in CLIPS.items():
            found = []
            for frame in clip[:: len(clip) // _SHOWN]:
                shot = dive.shot(frame, analysis.get(count) or dive.analysis([frame]), known=name != "measured")
                both = shot, replace(shot, pattern=None)
                found.append([remains(dive, frame, over(frame.image_linear, render(one))) for one in both])
            plate, left, texture = (
                np.mean([[getattr(one, key) for one in both] for both in found], axis=0)
                for key in ("plate", "left", "texture")
            )
            mean = np.mean([both[0].mean for both in found], axis=0)
            start = f"{water:5} {depth_m:.0f} {up_deg:3.0f} {'sand' if contrast else 'even':6} {name:9} {plate[0]:5.3f}"
            print(f"{start}  {left[0]:4.2f} ({left[1]:4.2f})  {mean.round(3)}  {texture[0]:5.2f} ({texture[1]:4.2f})")
    print("target: at most 0.25 left, mean within 0.03 of 1")


# --- cost ----------------------------------------------------------------------------------------------------------

_FRAMES, _SKIPPED, _ROUNDS = 12, 3, 3


def measure(moving: bool) -> float:
    """Return the median processor time [ms] of a layer of the four balls at 2048 x 1024, by the gl renderer."""
    renderer, scene, light = LayerRenderer(), SCENES["balls"], lights(SKIES["clear"])["known"]
    spent = []
    for k in range(_FRAMES):
        bodies = tuple(_moved(body, 0.01 * k if moving else 0.0) for body in scene.bodies)
        shot = replace(scene, bodies=bodies).shot(_new(light), 2048)
        start = time.process_time()
        renderer.render(shot)
        spent.append(1e3 * (time.process_time() - start))
    return float(np.median(spent[_SKIPPED:]))


def _moved(body: PlacedObject, shift_m: float) -> PlacedObject:
    matrix = body.world_from_object.copy()
    matrix[0, 3] += shift_m
    return replace(body, world_from_object=matrix)


def _new(light: Environment) -> Environment:
    """Return the light as of another frame: light changes in every frame of a video."""
    return replace(light)


def speed(checkout: str | None = None) -> None:
    """Processor time of a layer, light new in every frame, and its ratio to that of another checkout."""
    folders = [str(ROOT)] + ([str(Path(checkout).resolve())] if checkout else [])
    print(f"{'bodies':7} {'here ms':>9} {'there ms':>9} {'ratio':>6}   target: still 1.03, moving 1.25")
    for kind in ("still", "moving"):
        times: dict[str, list[float]] = {folder: [] for folder in folders}
        for _ in range(_ROUNDS):
            for folder, found in times.items():
                command = [sys.executable, str(Path(__file__)), "measure", folder, kind]
                found.append(float(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout))
        here, *there = (min(found) for found in times.values())
        other = f"{there[0]:9.1f} {here / there[0]:6.3f}" if there else f"{'-':>9} {'-':>6}"
        print(f"{kind:7} {here:9.1f} {other}")


SECTIONS: dict[str, Callable[..., None]] = {
    f.__name__: f for f in (truth, defaults, contact, furnace, caustics, speed, pictures)
}

if __name__ == "__main__":
    if sys.argv[1:2] == ["measure"]:
        print(measure(sys.argv[3] == "moving"))
    elif sys.argv[1:]:
        SECTIONS[sys.argv[1]](*sys.argv[2:])
    else:
        for section in (truth, defaults, contact, furnace, caustics, speed):
            print(f"\n{section.__name__}: {section.__doc__}")
            if section not in (truth, defaults) or has_mitsuba():
                section()
