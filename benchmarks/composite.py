# SPDX-License-Identifier: Apache-2.0
"""Objects in a plate: agreement of the renderers, energy, seam and poles, shadows, edges, speed, pictures.

    python benchmarks/composite.py [agreement | furnace | turn | shadow | edges [WIDTH] | speed [WIDTH]]
    python benchmarks/composite.py pictures FOLDER

`pictures` uses meshes beside the checkout, in shared/data/meshes; `edges` and `speed` the demo's whale and a ball.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from mr360uw.base.sphere import row_solid_angle, yaw_matrix  # noqa: E402
from mr360uw.composite import (  # noqa: E402
    ObjectSettings,
    Receiver,
    SceneObject,
    Shot,
    light_sources,
    load_object,
    render_layer,
)
from mr360uw.composite.gl.layer_renderer import LayerRenderer  # noqa: E402
from mr360uw.composite.mesh.material import Material  # noqa: E402
from mr360uw.composite.motion import rigid, rotation_matrix  # noqa: E402
from mr360uw.composite.tiles import over  # noqa: E402
from mr360uw.types import View  # noqa: E402
from tests.composite import scenes  # noqa: E402
from tests.composite.scenes import changed, codes, environment, medium, placed, plate, shot, sphere  # noqa: E402

MESHES = ROOT.parent / "shared" / "data" / "meshes"


def found(**settings: object) -> SceneObject:
    """Return an object with a mesh of the shared folder."""
    if not MESHES.is_dir():
        sys.exit(f"{MESHES} is not there; this section needs its meshes")
    paths = {k: MESHES / str(settings.pop(k)) for k in ("mesh", "texture") if k in settings}
    return load_object(ObjectSettings(**paths, **settings))


def at_origin(thing: SceneObject) -> object:
    """Return the object as it is at time 0."""
    return thing.at(0.0, 0, np.zeros(3), np.eye(3))


def difference(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    """Return PSNR [dB], part of the pixels within 2 codes, largest difference [codes] of encoded pictures."""
    d = np.abs(codes(a) - codes(b))
    return 20 * np.log10(255 / max(np.sqrt(np.mean(d**2)), 1e-6)), float(np.mean(d.max(axis=-1) <= 2)), float(d.max())


def agreement() -> None:
    """Compare gl with the reference on eight scenes."""
    renderer = LayerRenderer()
    print(f"{'scene':10} {'PSNR dB':>8} {'within 2/255':>13} {'largest':>8}   (target 45 dB, 0.999)")
    for name, scene in scenes.eight_shots(np.random.default_rng(360), 256).items():
        ground = plate(scene.view.width)
        result = difference(over(ground, renderer.render(scene)), over(ground, render_layer(scene)))
        print(f"{name:10} {result[0]:8.1f} {result[1]:13.5f} {result[2]:8.1f}")


def furnace() -> None:
    """White bodies in white light, and a body of the water's own radiance in water."""
    print("largest relative difference from the background (target 0.005)")
    white = environment(0.5)
    for name, metallic, roughness in (
        ("diffuse", 0.0, 1.0),
        ("glossy", 0.0, 0.2),
        ("metal", 1.0, 0.4),
        ("mixed", 0.5, 0.7),
    ):
        material = Material(base_color=(1.0, 1.0, 1.0, 1.0), metallic=metallic, roughness=roughness)
        scene = shot(placed(sphere(material=material), (0.2, 0.3, -1.2)), environment=white, sun=None, width=256)
        for renderer, render in (("reference", render_layer), ("gl", LayerRenderer().render)):
            image = over(np.full((128, 256, 3), 0.5, np.float32), render(scene))
            print(f"  {name:8} {renderer:10} {np.abs(image / 0.5 - 1).max():.6f}")
    far = np.float32([0.02, 0.12, 0.2])
    water = Material(base_color=(0.0, 0.0, 0.0, 1.0), emission=tuple(map(float, far)), refractive_index=1.34)
    scene = shot(placed(sphere(material=water), (0.0, -0.5, -2.0)), sun=None, medium=medium(), width=256)
    image = over(np.broadcast_to(far, (128, 256, 3)).copy(), LayerRenderer().render(scene))
    print(f"  water    gl         {np.abs(image / far - 1).max():.6f}")


def turn() -> None:
    """A yaw rolls the picture; a body over a pole has its area; the seam is like any other column."""
    renderer, width = LayerRenderer(), 512
    scene = replace(scenes.eight_shots(np.random.default_rng(360), width)["shadow"], caustics=None, medium=None)
    scene = replace(scene, receiver=Receiver(plane_y=-1.2))
    ground = plate(width)
    still = codes(over(ground, renderer.render(scene)))
    for columns in (195, 256, 511):
        turned = changed(scene, world_from_camera=yaw_matrix(2 * np.pi * columns / width))
        rolled = codes(over(np.roll(ground, -columns, axis=1), renderer.render(turned)))
        close = np.abs(rolled - np.roll(still, -columns, axis=1)).max(axis=-1) <= 1.0
        print(f"yaw of {360 * columns / width:6.1f} degrees: {close.mean():.5f} within 1/255 (target 0.999)")
    ball = sphere(96)
    for height in (1.5, -1.5):
        layer = renderer.render(shot(placed(ball, (0.1, height, -0.05)), width=width, sun=None))
        area = np.sum(layer.alpha.sum(axis=1) * row_solid_angle(width, width // 2))
        sine = 0.5 / np.linalg.norm([0.1, height, 0.05])
        expected = 2 * np.pi * (1 - np.sqrt(1 - sine**2))
        print(f"body over the pole at {height:+}: area {area / expected - 1:+.4%} (target 0.5 %)")
    seam = codes(over(ground, renderer.render(shot(placed(sphere(), (0.05, 0.1, 1.4)), width=width))))
    across = np.abs(np.diff(np.concatenate([seam[:, -3:], seam[:, :3]], axis=1), axis=1)).max(axis=-1)
    print(f"largest step across the seam {across[:, 2].max():.2f} codes, beside it {across[:, [1, 3]].max():.2f}")


def shadow() -> None:
    """Ratio in the penumbra against 1024 directions over the disc."""
    renderer = LayerRenderer()
    dark = replace(environment(), ambient=np.full((32, 64, 3), 1e-9))
    bodies = {
        "ball": placed(sphere(), (0.0, -0.3, -1.2)),
        "box on floor": placed(scenes.box((0.6, 0.5, 0.4)), (0.0, -0.95, -1.2), (30, 0, 0)),
        "sheet": placed(scenes.quad(size=0.8), (0.0, -0.2, -1.2), (0, -70, 0)),
    }
    light_sources.REFERENCE_SUN_FACTOR = 1
    print(f"{'disc rad':>8} {'body':14} {'pixels':>7} {'gl RMSE':>9} {'rays RMSE':>10}   (target 0.03)")
    for half in (0.00465, 0.03, 0.1):
        for name, body in bodies.items():
            sun = replace(scenes.SUN, half_angle_rad=half)
            receiver = Receiver(plane_y=-1.2, occlusion=False)
            scene = shot(body, width=512, environment=dark, receiver=receiver, sun=sun)
            truth = render_layer(changed(scene, sun_samples=1024)).ratio[..., 0]
            penumbra = (truth > 0.005) & (truth < 0.995)
            errors = [
                np.sqrt(np.mean((layer.ratio[..., 0] - truth)[penumbra] ** 2))
                for layer in (renderer.render(scene), render_layer(changed(scene, sun_samples=96)))
            ]
            print(f"{half:8} {name:14} {penumbra.sum():7} {errors[0]:9.4f} {errors[1]:10.4f}")


def two_meshes(width: int, shift: float = 0.0, *, receiver: bool = True) -> Shot:
    """Return the whale and a ball, about one per cent of the frame."""
    whale, ball = _TWO or _load_two()
    objects = (
        replace(
            at_origin(whale),
            world_from_object=rigid((-0.6 + shift, -0.8, -2.6), rotation_matrix((70, 0, 0)), 0.5),
        ),
        replace(ball, world_from_object=rigid((1.6 + shift, -1.15, -4.5), np.eye(3), 1.0)),
    )
    view = View(width, width // 2)
    return Shot(view, objects, _LIGHT, (scenes.SUN,), receiver=_FLOOR if receiver else None, medium=_WATER)


_TWO: list[Any] = []
_LIGHT, _FLOOR, _WATER = environment(), Receiver(plane_y=-2.0), medium()


def _load_two() -> list[Any]:
    whale = load_object(ObjectSettings(mesh=ROOT / "samples" / "demo" / "whale.glb"))
    _TWO.extend([whale, placed(sphere(), (0.0, 0.0, 0.0))])
    return _TWO


def edges(width: int = 1024) -> None:
    """Edge pixels against 8 x 8 pixels of a picture eight times as large, each lit by itself."""
    renderer = LayerRenderer()
    ground = plate(width)
    base = two_meshes(width, receiver=False)
    near = replace(
        base, objects=tuple(replace(o, world_from_object=_nearer(o.world_from_object)) for o in base.objects)
    )
    print(f"{'body':8} {'samples':>7} {'shading':8} {'edges':>14} {'inside':>7} {'alpha':>11}  RMSE, target 2")
    for name, body in zip(("whale", "ball"), near.objects, strict=True):
        scene = replace(near, objects=(body,))
        fine = render_layer(changed(scene, width=8 * width, height=4 * width, samples=1))
        alpha, radiance = _mean_of_64(fine.alpha), _mean_of_64(fine.radiance)
        partly, fully = (alpha > 0.004) & (alpha < 0.996), alpha >= 0.996
        expected = codes(radiance + (1.0 - alpha[..., None]) * ground)
        for samples, shading in ((5, "pixel"), (17, "pixel"), (41, "pixel"), (65, "pixel"), (65, "sample")):
            layer = renderer.render(changed(scene, samples=samples, shading=shading))
            d = codes(over(ground, layer)) - expected
            a = 255 * np.sqrt(np.mean((layer.alpha - alpha)[partly] ** 2))
            rmse = [np.sqrt(np.mean(d[where] ** 2)) for where in (partly, fully)]
            print(f"{name:8} {samples:7} {shading:8} {rmse[0]:14.2f} {rmse[1]:7.2f} {a:11.2f}")


def _mean_of_64(image: np.ndarray) -> np.ndarray:
    """Return the means of 8 x 8 pixels."""
    height, width = image.shape[0] // 8, image.shape[1] // 8
    return image.reshape(height, 8, width, 8, *image.shape[2:]).mean(axis=(1, 3))


def _nearer(matrix: np.ndarray) -> np.ndarray:
    moved = matrix.copy()
    moved[:3, 3] *= 0.6
    return moved


def speed(width: int = 2048) -> None:
    """Processor and wall time of a layer, 2048 columns by default; light new in every frame, as in a video."""
    renderer = LayerRenderer()
    print(f"{'receiver':8} {'moving':6} {'samples':>7} {'processor ms':>13} {'wall ms':>8} {'covered':>8}  tiles")
    for receiver in (False, True):
        for moving in (False, True):
            for samples in (17, 65):
                spent = []
                for k in range(12):
                    scene = two_meshes(width, 0.01 * k if moving else 0.0, receiver=receiver)
                    scene = changed(scene, samples=samples, environment=replace(_LIGHT))
                    start = time.process_time(), time.perf_counter()
                    layer = renderer.render(scene)
                    spent.append((time.process_time() - start[0], time.perf_counter() - start[1]))
                cpu, wall = 1e3 * np.median(spent[3:], axis=0)
                covered = layer.alpha.mean()
                sizes = ", ".join(f"{t.alpha.shape[1]}x{t.alpha.shape[0]}" for t in layer.tiles)
                print(f"{receiver!s:8} {moving!s:6} {samples:7} {cpu:13.1f} {wall:8.1f} {covered:8.2%}  {sizes}")


def pictures(folder: str) -> None:
    """Write pictures of found meshes by both renderers, side by side, and their difference times twenty."""
    import cv2

    water = medium(6.0, (0.25, 0.05, 0.04))
    cow = "spot/spot_triangulated.obj"
    fish = {"scale": 0.04, "position_m": (0, -0.6, -1.5), "rotation_deg": (70, 0, 0)}
    turned = {"position_m": (0, -0.5, -2.0), "rotation_deg": (150, 0, 0)}
    stages = {
        "alpha": found(mesh="AlphaBlendModeTest.glb", scale=0.5, position_m=(0, -0.4, -2.4)),
        "snapper": found(mesh="greySnapper_vertColor.glb", **fish),
        "spot": found(mesh=cow, texture="spot/spot_texture.png", **turned),
        "truck": found(mesh="CesiumMilkTruck.glb", scale=0.5, position_m=(0, -1.25, -2.4), rotation_deg=(40, 0, 0)),
    }
    renderer, width = LayerRenderer(), 1024
    for name, thing in stages.items():
        objects = (at_origin(thing),)
        scene = Shot(
            View(width, width // 2, surface_y_m=6.0),
            objects,
            environment(),
            (scenes.SUN,),
            medium=water,
            receiver=Receiver(plane_y=-1.3),
        )
        ground = plate(width)
        both = [over(ground, render(scene)) for render in (renderer.render, render_layer)]
        psnr, close, largest = difference(*both)
        print(f"{name:8} gl against reference: {psnr:.1f} dB, {close:.5f} within 2/255, largest {largest:.1f}")
        shown = [codes(image)[150:450, 262:762] for image in both]
        picture = np.concatenate([*shown, 20 * np.abs(shown[0] - shown[1])], axis=1)
        cv2.imwrite(str(Path(folder) / f"{name}.png"), np.clip(picture, 0, 255).astype(np.uint8)[..., ::-1])


SECTIONS = {f.__name__: f for f in (agreement, furnace, turn, shadow, edges, speed)}

if __name__ == "__main__":
    if len(sys.argv) > 2 and sys.argv[1] == "pictures":
        pictures(sys.argv[2])
    else:
        widths = [int(word) for word in sys.argv[1:] if word.isdigit()]
        for section in [word for word in sys.argv[1:] if not word.isdigit()] or SECTIONS:
            print(f"\n{section}: {SECTIONS[section].__doc__}")
            SECTIONS[section](*(widths if section in ("edges", "speed") else ()))
