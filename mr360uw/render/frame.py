# SPDX-License-Identifier: Apache-2.0
"""Stages of one frame, from the plate to the composite, for videos, stills, library calls and previews alike, and the
renderers that draw it.

Each stage takes all that it needs. `composite_frame` runs them one after the other; over a clip (`runs.job`) each of
the three runs on a thread of its own, ahead of the next stage: what measures a plate and says what is to be drawn, what
draws, and what blends and writes.

What both eyes of a stereo plate see is found once: light, sun, gain and water in the left eye's picture, so that no
difference between the pictures makes their objects differ; caustics, shafts, shadow maps and ambient light do not
depend on the eye. The plate's own caustics are smoothed in each eye's picture alike: a clip's mean is kept of the left
eye alone.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args

import numpy as np

from mr360uw.base.cache import Cache, drop_shared
from mr360uw.base.color import LEAST_CHANGE, unseen_changes
from mr360uw.base.constants import JUST_BELOW_M
from mr360uw.base.optics import into_air
from mr360uw.base.tile_blend import BLOCK
from mr360uw.caustics.settings import CausticSettings, Sea
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.light_sources import lamps_of, sun_of
from mr360uw.composite.settings import DrawSettings
from mr360uw.composite.shot import Shot, object_presence
from mr360uw.composite.tiles import mean_layer
from mr360uw.errors import GlError, ParameterError, RenderError
from mr360uw.ibl.lighting import turned
from mr360uw.medium import Medium
from mr360uw.medium.scattered_light import image_spread, spread_of
from mr360uw.render.first_pass import Background, ClipAnalysis, plate_pattern
from mr360uw.render.loaded import Loaded
from mr360uw.render.match_stage import asked_grade, ungraded, with_grade
from mr360uw.render.plate_light import FrameLight, exposed_water, plate_light
from mr360uw.render.surroundings import Surroundings
from mr360uw.types import BeamSpread, CausticStack, Floats, Layer, MediumTable, Sun, Tile
from mr360uw.video import VideoFrame

if TYPE_CHECKING:
    from mr360uw.composite.gl.layer_renderer import LayerRenderer
    from mr360uw.composite.receiver.blocks import Prepared
    from mr360uw.composite.shafts import ShaftInput

T = TypeVar("T")
_LOWEST_SUN = 0.05
"""Sine of the sun's elevation in air below which no caustics are computed: the beam is oblique and weak."""
_DEEPER = 3.0
"""How far below the camera waves are followed for the whole plate, in lengths over which daylight falls to 1/e."""
_NOT_OF_LAYERS = {name: DrawSettings.model_fields[name].default for name in ("grain", "motion_samples", "shutter")}
"""Settings of drawing that the layer of one instant does not depend on."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One composited frame and its intermediate results; stages that the scene does not need are None.

    picture: the plate with the layer over it. plate: its light is read without its grade. caustics: of the last
    instant. variables: the layer's output variables if they were asked for; they have no motion blur. right: of a
    stereo plate, whose left eye this is, the frame of the right one; `picture` has the right eye's picture too.
    """

    picture: VideoFrame
    plate: VideoFrame
    layer: Layer
    light: FrameLight | None = None
    medium: MediumTable | None = None
    caustics: CausticStack | None = None
    variables: Aovs | None = None
    right: Frame | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """What an eye sees at one instant of a frame's exposure: the shot, and its shafts, None where there are none.

    time_s: of the instant [s]. now: the scene then. exposure_s: that it stands for. prepared: of `Backend.prepare`.
    """

    time_s: float
    now: Loaded
    shot: Shot
    shafts: ShaftInput | None
    exposure_s: float
    prepared: Prepared | None


@dataclass(frozen=True, slots=True, eq=False)
class FrameShots:
    """What is to be drawn for a frame.

    now: the scene at the frame's time. filed: the plate with its grade. light: None where nothing is lit. water: None
    without any. eyes: for each eye the plate without its grade, and the instants of the exposure.
    """

    now: Loaded
    filed: VideoFrame
    light: FrameLight | None
    water: MediumTable | None
    eyes: tuple[tuple[VideoFrame, tuple[Instant, ...]], ...]


Drawn = tuple[tuple[tuple[Layer, Aovs | None], ...], ...]
"""For each eye of a frame, the layer of every instant and, if asked for, the layer's output variables."""


def composite_frame(
    loaded: Loaded,
    analysis: ClipAnalysis,
    backend: Backend,
    plate: VideoFrame,
    shutter_s: float,
    *,
    cache: Cache | None = None,
    light: FrameLight | None = None,
) -> Frame:
    """Return a frame, a function of what is loaded, the clip's analysis and the plate's frame alone.

    shutter_s: exposure time [s], for motion blur. light: between samples of a clip (`plate_light.LightSamples`); None
    measures it in this frame. cache: results of the same backend's frames: a stage runs unless its result is there.
    """
    cache = Cache(loaded.scene.plate.eyes) if cache is None else cache
    shots = frame_shots(loaded, analysis, backend, plate, shutter_s, cache, light)
    return blend_frame(loaded, analysis, shots, draw_frame(backend, shots, cache), cache)


def frame_shots(
    loaded: Loaded, analysis: ClipAnalysis, backend: Backend, filed: VideoFrame, shutter_s: float, cache: Cache,
    light: FrameLight | None = None,
) -> FrameShots:  # fmt: skip
    """Return what is to be drawn for a plate's frame, with its light, water, caustics and shafts, on any thread.

    Raises `ParameterError` where the scene works on both eyes and the frame is one panorama.
    """
    now, time_s, index = loaded.at(filed.time_s), filed.time_s, filed.index
    plate = ungraded(now, analysis.grade, filed, cache)
    # What the eyes of the plate show, and how far each is to the right of the middle
    pictures = [(plate, 0.0)]
    if now.scene.plate.eye == "both":
        if plate.right is None:
            raise ParameterError(
                'plate.eye - is "both", but the frame has one eye - take frames that open_video(..., eye="both") '
                "reads, or leave out plate.eye"
            )
        half_m = 0.5 * now.scene.camera.ipd_m
        pictures = [(plate, -half_m), (plate.right, half_m)]
    if not loaded.plan.layer.runs:
        return FrameShots(now, filed, None, None, tuple((picture, ()) for picture, _ in pictures))
    # Measure light and water, which hold for all instants
    light = plate_light(now, analysis, plate, cache) if light is None else light
    finite("light", index, (light.environment, light.gain, light.plate_ratio))
    water = finite("water", index, cache.of(exposed_water, now.surroundings, light, time_s))
    shown = [shown_to_eye(now, analysis.background, eye, *pictures[eye], cache) for eye in range(len(pictures))]
    # Instants over which the frame is averaged for motion blur, one without it
    steps = now.scene.draw.motion_samples if shutter_s > 0.0 and loaded.moves else 1
    times = time_s + ((np.arange(steps) + 0.5) / steps - 0.5) * shutter_s
    seen: list[list[Instant]] = [[] for _ in pictures]
    for instant_s in times.tolist():
        then = now if steps == 1 else loaded.at(instant_s, now)
        shot = shot_at(then, backend, light, water, instant_s, index, cache)
        shafts = shafts_of(then, backend, shot, instant_s, cache)
        for (_, eye_m), fields_of_eye, instants in zip(pictures, shown, seen, strict=True):
            of_eye = replace(shot, view=replace(shot.view, eye_m=eye_m), **fields_of_eye)
            prepared = cache.of(backend.prepare, of_eye, cache, keep=2)
            instants.append(Instant(instant_s, then, of_eye, shafts, shutter_s / steps, prepared))
    eyes = tuple((picture, tuple(instants)) for (picture, _), instants in zip(pictures, seen, strict=True))
    return FrameShots(now, filed, light, water, eyes)


def draw_frame(backend: Backend, shots: FrameShots, cache: Cache, *, variables: bool = False) -> Drawn:
    """Return the layers of a frame, on the thread of its backend."""
    by_eye = []
    for _, instants in shots.eyes:
        drawn = []
        for at in instants:
            layer, found = cache.of(draw_layer, backend, at.shot, at.prepared, at.shafts, variables, cache)
            if at.now.plan.blur.runs:
                layer, found = cache.of(blurred_layer, at.now.surroundings, at.shot, layer, found, cache)
            if at.now.plan.surface.runs:
                layer, found = with_surface(at, backend, layer, found, cache)
            if at.now.plan.snow.runs:
                layer, found = with_snow(at, backend, layer, found, cache)
            drawn.append((layer, found))
        by_eye.append(tuple(drawn))
    return tuple(by_eye)


def blend_frame(loaded: Loaded, analysis: ClipAnalysis, shots: FrameShots, by_eye: Drawn, cache: Cache) -> Frame:
    """Return the composite of what was drawn and the plate, on any thread, beside the next frame."""
    frames = []
    for (plate, instants), drawn in zip(shots.eyes, by_eye, strict=True):
        layers = [layer for layer, _ in drawn] or [Layer(loaded.height, loaded.width, ())]
        layer = layers[0] if len(layers) == 1 else mean_layer(layers)
        if any(np.any(tile.alpha > 0.0) for tile in layer.tiles):
            look = asked_grade(shots.now, analysis.grade, shots.filed, cache)  # of the left eye for both
            layer = cache.of(with_grade, layer, look, plate) if look.reach_px > 0 else layer
        picture = cache.of(VideoFrame.over, plate, layer, shots.now.scene.draw.grain, finite_layer)
        caustics, variables = (instants[-1].shot.caustics, drawn[-1][1]) if drawn else (None, None)
        frames.append(Frame(picture, plate, layer, shots.light, shots.water, caustics, variables))
    if len(frames) == 1:
        return frames[0]
    left, right = frames
    return replace(left, picture=replace(left.picture, right=right.picture), right=right)


def shown_to_eye(
    now: Loaded, background: Background | None, number: int, plate: VideoFrame, eye_m: float, cache: Cache
) -> dict[str, Any]:
    """Return the fields of a shot that one eye's picture shows: receiver, the plate's own caustics there, and mattes.

    background: of the clip. eye_m: of the eye to the right of the middle. cache: holds what does not change from frame
    to frame.
    """
    if background is not None and eye_m:  # the mean is of the left eye's pictures
        background = Background(None, background.strength)
    shown: dict[str, Any] = {
        "receiver": now.receiver_at(plate.index, plate.time_s, number, eye_m),
        "pattern": plate_pattern(now, background, plate, cache),
    }
    if shown["receiver"] is not None:
        shown["unseen"] = _unseen_in_blocks(plate)
    mask, metres = now.mattes.at(plate.index, number)
    # What the plate's own depth hides is added to the mattes, with what lies beside the edges of it
    if now.plate_depth is not None:
        of_plate = now.plate_depth.surfaces(plate.index, plate, number)
        nearer = [of_plate.distance_m, of_plate.beside_m]
        if metres is not None:
            nearer = [None if one is None else np.minimum(metres, one) for one in nearer]
        metres, beside_m = nearer
        shown["holdout_soft"] = True
        if beside_m is not None and of_plate.share is not None:
            shown["holdout_beside"] = beside_m, of_plate.share
    return shown | {"holdout": mask, "holdout_distance_m": metres}


def _unseen_in_blocks(plate: VideoFrame) -> Floats | float:
    """Return `Shot.unseen` of a plate, by the brightest of four pixels of each of its blocks."""
    if plate.yuv is not None:
        codes = plate.yuv.y
    else:
        assert plate.rgb is not None
        codes = plate.rgb[..., 1]
    if codes.dtype.kind == "f":
        return LEAST_CHANGE
    (height, width), half = codes.shape, BLOCK // 2
    rows = np.minimum(np.arange(half // 2, -(-height // BLOCK) * BLOCK, half), height - 1)
    columns = np.minimum(np.arange(half // 2, -(-width // BLOCK) * BLOCK, half), width - 1)
    few = np.take(codes[rows], columns, axis=1)
    few = np.maximum(few[::2], few[1::2])
    return unseen_changes(plate.spec)[np.maximum(few[:, ::2], few[:, 1::2])]


def shot_at(
    loaded: Loaded, backend: Backend, light: FrameLight, water: MediumTable | None, time_s: float, index: int,
    cache: Cache,
) -> Shot:  # fmt: skip
    """Return the shot of an instant of frame `index`, without what is of one eye (`shown_to_eye`).

    cache: holds the light in the world's axes, and caustics of the same backend.
    """
    # Place the camera, its light, the objects and the lamps
    view = loaded.view(time_s)
    environment = cache.of(turned, light.environment, view.world_from_camera)
    objects = tuple([o.at(time_s, index, view.position, view.world_from_camera) for o in loaded.objects])
    sun: tuple[Sun, ...] = () if environment.sun is None else (environment.sun,)
    shot = Shot(
        view=view, objects=objects, environment=environment, medium=water, between=light.between,
        lights=(*sun, *[lamp.at(time_s, view, objects) for lamp in loaded.lamps]),
        draw=loaded.scene.draw.model_copy(update=_NOT_OF_LAYERS),
    )  # fmt: skip
    # Cast the caustics of a sun that is high enough, on planes around the objects' depths
    if not sun or not loaded.plan.caustics.runs:
        return shot
    depths = loaded.caustic_depths
    planes, ground_m = depths.planes(shot), depths.shadow_m(shot)
    stack = _caustics(loaded, backend, shot, depths.settings, planes, time_s, cache, ground_m)
    return replace(shot, caustics=stack)


def shafts_of(loaded: Loaded, backend: Backend, shot: Shot, time_s: float, cache: Cache) -> ShaftInput | None:
    """Return what the shafts of a shot depend on beside it; None where none show, or the camera is not below.

    cache: holds caustics of the same backend.
    """
    medium, settings = loaded.surroundings.medium, loaded.scene.shafts
    camera_m = shot.view.surface_y_m - float(shot.view.position[1])
    if not loaded.plan.shafts.runs or medium is None or camera_m < 0.0:
        return None
    from mr360uw.composite.shafts import ShaftInput, shafts_show

    waves, bodies = shafts_show(shot, settings, medium)
    if shot.caustics is None or not waves:
        return ShaftInput(settings, medium) if bodies or lamps_of(shot) else None
    depths = loaded.caustic_depths
    deepest_m = camera_m + min(settings.range_m, _DEEPER * medium.length_m) if settings.on_plate else 0.0
    planes = depths.water_planes(shot, deepest_m)
    return ShaftInput(settings, medium, _caustics(loaded, backend, shot, depths.of_water, planes, time_s, cache))


def _caustics(
    loaded: Loaded, backend: Backend, shot: Shot, settings: CausticSettings, depths_m: Floats, time_s: float,
    cache: Cache, ground_m: float | None = None,
) -> CausticStack | None:  # fmt: skip
    """Return a backend's caustics of a shot's sun, for its bodies or for the water; None where it makes none.

    depths_m: (n,) of their planes. ground_m: depth of the ground that shadows fall on.
    """
    sun, medium, sea = sun_of(shot), loaded.surroundings.medium, loaded.scene.sea
    if sun is None or medium is None:
        return None
    index = loaded.scene.water.refractive_index
    in_air = into_air(sun.direction, index)
    if in_air[1] < _LOWEST_SUN:
        return None
    spread = spread_of(medium)
    return cache.of(backend.caustics, sea, in_air, depths_m, time_s, settings, index, spread, ground_m, keep=2)


def draw_layer(
    backend: Backend, shot: Shot, prepared: Prepared | None, shafts: ShaftInput | None, variables: bool, cache: Cache
) -> tuple[Layer, Aovs | None]:
    """Return the layer of a shot, with its shafts, and its output variables if asked for."""
    layer, found = backend.layer(shot, prepared, variables=variables)
    if shafts is not None:
        from mr360uw.composite.shafts import with_shafts

        layer, found = with_shafts(shot, shafts, layer, found, cache)
    return layer, found


def blurred_layer(
    around: Surroundings, shot: Shot, layer: Layer, variables: Aovs | None, cache: Cache
) -> tuple[Layer, Aovs | None]:
    """Return a shot's layer and its variables as the water blurs them; as they are where it blurs nothing."""
    from mr360uw.composite.water_blur import with_blur

    spread = None if around.medium is None else cache.of(image_spread, around.medium)
    return (layer, variables) if spread is None else with_blur(shot, spread, layer, variables, cache)


def with_snow(
    at: Instant, backend: Backend, layer: Layer, variables: Aovs | None, cache: Cache
) -> tuple[Layer, Aovs | None]:
    """Return the layer of an instant and its variables with its snow, drawn out over its exposure.

    cache: holds layers of the same backend; a layer stands for all that its shot depends on.
    """
    from mr360uw.composite.snow import Snow, with_particles
    from mr360uw.composite.snow_particles import particle_scattering

    medium, scene, half = at.now.surroundings.medium, at.now.scene, 0.5 * at.exposure_s
    assert medium is not None, "the plan has no snow without water"
    views = [replace(at.now.view(at_s), eye_m=at.shot.view.eye_m) for at_s in (at.time_s - half, at.time_s + half)]
    snow = Snow(scene.snow, particle_scattering(medium.water), scene.sea, at.time_s, at.exposure_s, *views)
    return cache.of(with_particles, snow, at.shot, layer, variables, backend.cache)


def with_surface(
    at: Instant, backend: Backend, layer: Layer, variables: Aovs | None, cache: Cache
) -> tuple[Layer, Aovs | None]:
    """Return the layer of an instant and its variables with the moving surface; as they are where no object is near it.

    Images of bodies in the surface are in the layer alone, the cut through bodies is in both. cache: holds layers of
    the same backend; a layer stands for all that its shot depends on.
    """
    settings, shot, around = at.now.scene.surface, at.shot, at.now.surroundings
    below = shot.view.position[1] < shot.view.surface_y_m
    if shot.medium is None or not below or not np.any(object_presence(shot, settings) > 0.0):
        return layer, variables
    from mr360uw.composite.surface_layer import with_bodies
    from mr360uw.composite.surface_rays import table_at_surface

    # The frame's water, for rays that start at the surface
    medium, still = around.medium_at(at.time_s), around.medium
    assert medium is not None
    assert still is not None
    of_surface = cache.of(_unit_table_below_surface, still)
    table = cache.of(table_at_surface, shot.medium, medium.unit_table, of_surface)
    layer, before = cache.of(with_bodies, shot, at.now.scene.sea, at.time_s, table, settings, layer, backend.cache)
    return layer, variables if variables is None or before is None else variables.cut(before)


def _unit_table_below_surface(medium: Medium) -> MediumTable:
    """Return the table without gain of a water for rays from just below its surface."""
    return medium.at_depth(JUST_BELOW_M).unit_table


def finite_layer(index: int, tile: Tile) -> Tile:
    """Return a tile of a frame's layer; raise `RenderError` if it is not finite."""
    return finite("layer", index, tile)


def finite(stage: str, index: int, result: T) -> T:
    """Return a stage's result of a frame; raise `RenderError` if `not_finite` finds anything in it."""
    if found := not_finite(result):
        raise RenderError(
            f"frame {index} - the {stage} has numbers that are not finite (got {found}) - please report it with the "
            "scene file"
        )
    return result


def not_finite(result: object, name: str = "it") -> str:
    """Return where an array of floats in a result has a NaN or an infinity; "" where none has. Distances may.

    result: an array, or a dataclass or tuple of such. Sums are tested first.
    """
    if isinstance(result, np.ndarray):
        if result.dtype.kind != "f" or name == "distance_m":
            return ""
        with np.errstate(all="ignore"):
            total = result.sum()
        if np.isfinite(total) or np.all(np.isfinite(result)):
            return ""
        return f"{np.sum(~np.isfinite(result))} of {result.size} in {name}"
    parts = [(name, part) for part in result] if isinstance(result, tuple) else []
    if is_dataclass(result):
        parts = [(one.name, getattr(result, one.name)) for one in fields(result)]
    for of, part in parts:
        if (isinstance(part, np.ndarray | tuple) or is_dataclass(part)) and (found := not_finite(part, of)):
            return found
    return ""


# --- Both renderers, and which one draws ----------------------------------------------------------------------------

# The two renderers behind one interface, and the choice between them.
#
# `reference` casts rays in float64 NumPy, defines the right answer and needs no OpenGL. `gl` computes the same with
# OpenGL 3.3.


BackendName = Literal["auto", "gl", "reference"]
CausticsOf = Callable[
    [Sea, Floats, Floats, float, CausticSettings, float, BeamSpread | None, float | None], CausticStack
]
"""Caustics of a sea under the direction of a sun in air (3,), on planes at depths (n,) [m], at a time [s]; with the
refractive index of the water, the spread of the beam that it turns by small angles, and the depth [m] of the ground
that shadows fall on."""


class Reference:
    """The reference renderer: float64 on the processor."""

    name = "reference"
    device = "processor, float64"

    def __init__(self, cache: Cache | None = None) -> None:
        self.cache = Cache() if cache is None else cache

    @property
    def caustics(self) -> CausticsOf:
        """`mr360uw.caustics.caustic_stack`."""
        from mr360uw.caustics import caustic_stack

        return caustic_stack

    def prepare(self, shot: Shot, cache: Cache) -> Prepared | None:
        """Return nothing: every pixel is found by itself."""

    def layer(
        self,
        shot: Shot,
        prepared: Prepared | None = None,  # noqa: ARG002 - as `Gl` has it
        *,
        variables: bool = False,
    ) -> tuple[Layer, Aovs | None]:
        """Return the layer of `mr360uw.composite.reference`."""
        from mr360uw.composite.reference import render_aovs, render_layer

        return render_aovs(shot, self.cache) if variables else (render_layer(shot, self.cache), None)

    def release(self) -> None:
        """Empty the cache."""
        self.cache.clear()


class Gl:
    """The OpenGL renderer, for the thread that made it."""

    name = "gl"

    def __init__(self, cache: Cache | None = None) -> None:
        from mr360uw.composite.gl.layer_renderer import LayerRenderer
        from mr360uw.gl import gl_device

        self.device = gl_device().renderer
        self.cache = Cache() if cache is None else cache
        self._layers: LayerRenderer | None = LayerRenderer(self.cache)
        self._thread = threading.get_ident()

    @property
    def caustics(self) -> CausticsOf:
        """`summed_stack`."""
        from mr360uw.caustics.summed_stack import summed_stack

        return summed_stack

    def prepare(self, shot: Shot, cache: Cache) -> Prepared | None:
        """Return the ambient light of a shot's bodies, and the receiver that they may change."""
        from mr360uw.composite.receiver.blocks import prepare

        return prepare(shot, cache)

    def layer(
        self, shot: Shot, prepared: Prepared | None = None, *, variables: bool = False
    ) -> tuple[Layer, Aovs | None]:
        """Return the layer of a shot, and its output variables if asked for, read back from the device."""
        if self._layers is None:  # released
            from mr360uw.composite.gl.layer_renderer import LayerRenderer

            self._layers = LayerRenderer(self.cache)
        return self._layers.layer(shot, prepared, variables=variables)

    def release(self) -> None:
        """Let go of all that is kept between frames, here and on the device; a later frame makes it anew.

        Asked for on another thread, it is the next frame on the renderer's thread that releases what is on the device.
        """
        from mr360uw.gl import release_unused

        self.cache.clear()
        self._layers = None
        if threading.get_ident() == self._thread:
            release_unused()


Backend = Reference | Gl
"""The stages that a renderer computes: caustics, and the layer of objects with its output variables.

`prepare` finds on any thread what of a shot's layer can be found there, None for nothing, with a cache of that thread;
`layer` takes it, and finds it itself without. `cache` holds values between frames; it may be emptied. `release` lets go
of all that is kept, here and on the device; a later frame makes it anew.
"""


def close_backend(backend: Backend) -> None:
    """Let go of all that a backend and the scenes of this process keep; scenes still open make it anew."""
    backend.release()
    drop_shared()


def check_backend(name: str) -> None:
    """Raise `ParameterError` for the name of a backend that there is not."""
    if name not in get_args(BackendName):
        names = ", ".join(get_args(BackendName))
        raise ParameterError(f"backend - is not known (got {name!r}) - take one of {names}")


def make_backend(name: BackendName | str = "auto", cache: Cache | None = None) -> tuple[Backend, str]:
    """Return a backend and, where the reference or the processor stands in for it, a line with the reason (else "").

    Before `auto` takes a graphics card for the first time, one small picture shows whether it draws right. cache: that
    it is to have; None for an own one. Raises `GlError` if "gl" is asked for and OpenGL is not available,
    `ParameterError` for an unknown name.
    """
    check_backend(name)
    if name == "reference":
        return Reference(cache), ""
    try:
        found = Gl(cache)
    except GlError as error:
        if name == "gl":
            raise
        return Reference(cache), f"no OpenGL, so the reference renderer runs ({error})"
    if name == "auto":
        from mr360uw.composite.gl.self_test import doubt_of_device

        if doubt := doubt_of_device():
            return Reference(cache), f"{found.device} fails its first trial, so the reference renderer runs ({doubt})"
    return found, ""
