# SPDX-License-Identifier: Apache-2.0
"""Plan of a run: which stages a scene needs, with the reason for each, decided before the first frame; among
them the depths at which caustics are drawn.

A stage that changes nothing does not run. The plan depends on the scene, its meshes' materials, its water and the kind
of plate alone, so it can be printed (`--explain`) and tested. Conditions of a single frame (no sun in it, nothing
visible) are found frame by frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np

from mr360uw.caustics.settings import CausticSettings, PlaneLadder, Span, grid_of, map_size
from mr360uw.caustics.sun_disc import detail_footprint
from mr360uw.composite import Receiver, SceneObject, Shot
from mr360uw.composite.settings import NEAREST_M
from mr360uw.composite.shot import FAINTEST, WITHIN_M
from mr360uw.ibl import LightSettings
from mr360uw.medium.lookup import beam_fraction, transmittance_lookup
from mr360uw.render.surroundings import CameraPath
from mr360uw.scene.model import Scene
from mr360uw.types import Floats, MediumTable

_LEAST_SHARE = 0.01
"""Fraction of the veil that the beam's first scattering must add: what shafts change is less than that."""


_NEGLIGIBLE_BEAM = 0.002
"""Fraction of the surface's beam below which caustics and shadows are less than half an 8-bit code value."""
Share = Callable[[], float] | None


@dataclass(frozen=True, slots=True)
class Stage:
    """Whether a stage runs, and the reason."""

    runs: bool
    why: str


@dataclass(frozen=True, slots=True)
class ObjectFacts:
    """Properties of an object that the plan depends on.

    depth_m: least depth of its highest point below the mean surface over the clip. glossy: whether a material is
    smoother than diffuse. moves: whether it moves in the world.
    """

    depth_m: float
    glossy: bool
    moves: bool


Facts = tuple[ObjectFacts, ...]


def stage(runs: bool, yes: str, no: str) -> Stage:
    """Return a stage with the reason for which it runs, or does not."""
    return Stage(runs, yes if runs else no)


def sun_stage(light: LightSettings, visible: bool, beam: float) -> Stage:
    """Return whether the sun lights a scene. beam: fraction of its beam that reaches an object."""
    deep = beam < _NEGLIGIBLE_BEAM
    return stage(
        visible and light.sun != "none" and not deep,
        f"sun: {light.sun}",
        "nothing to light" if not visible
        else 'light.sun = "none"' if light.sun == "none"
        else f"{100 * beam:.2f} % of the beam reaches the objects",
    )  # fmt: skip


def shadow_stage(scene: Scene, *, lit: bool) -> Stage:
    """Return whether shadows are cast on the receiver."""
    receiver = scene.receiver
    return stage(
        lit and receiver is not None and receiver.shadow,
        "the receiver catches shadows",
        "no receiver" if receiver is None else "switched off" if not receiver.shadow else "no sun to cast one",
    )


def shafts_stage(
    scene: Scene, objects: Facts, medium: MediumTable | None, share: Share, *, lit: bool, waves: bool
) -> Stage:
    """Return whether light in the water is drawn. share: see `make_plan`. lit, waves: whether there are a sun and its
    caustics.
    """
    settings, lamps = scene.shafts, len(scene.lamps)
    off = "no objects" if not objects else settings.why_off or ("" if medium is not None else 'water is "none"')
    if off:
        return Stage(False, off)
    shading = any(placed.casts_shadow for placed in scene.objects)
    if not lamps and not (lit and (waves or shading)):
        return Stage(False, "no sun and no lamps" if not lit else "neither waves nor bodies change the beam")
    of_beam = 1.0 if share is None else share()
    if of_beam == 0.0 and not lamps:
        return Stage(False, "the water does not scatter")
    by = [word for word, there in (("waves", lit and waves), ("bodies", lit and shading), ("lamps", lamps)) if there]
    number = f"{100 * of_beam:.2g} % of the veil is light of the beam scattered once"
    if settings.mode == "auto" and of_beam < _LEAST_SHARE and not lamps:
        return Stage(False, f"{number}, below {100 * _LEAST_SHARE:g} %")
    least = f"; where codes change by {settings.least_codes:g}" if settings.least_codes else ""
    return Stage(True, f"by {', '.join(by)}; {number}{least}")


def blur_stage(scene: Scene, objects: Facts, medium: MediumTable | None) -> Stage:
    """Return whether the water blurs objects: closed forms and fitted formations do not tell how light turns."""
    if not objects or medium is None:
        return Stage(False, "no objects" if not objects else 'water is "none"')
    told = scene.water.mode in ("table", "plate")
    return stage(
        scene.water.blur and told,
        "the water turns light of objects by small angles",
        f'water.mode "{scene.water.mode}" does not tell how light turns' if not told else "switched off",
    )


def surface_stage(scene: Scene, objects: Facts, medium: MediumTable | None) -> Stage:
    """Return whether the surface shows and cuts objects: those near it whose image the water leaves bright enough."""
    settings = scene.surface
    if settings.objects == "none" or not objects or medium is None:
        return Stage(
            False, "switched off" if settings.objects == "none" else "no objects" if not objects else 'water is "none"'
        )
    depth_m, camera = min(facts.depth_m for facts in objects), scene.camera
    shallowest_m = 0.0  # a lower bound of the camera's depth
    if camera.track is None:
        shallowest_m = max(min([camera.depth_m, *(keyed_m for _, keyed_m in camera.depth_keys)]), 0.0)
    within = np.inf if settings.objects == "all" else WITHIN_M
    left = float(transmittance_lookup(medium, shallowest_m + max(depth_m, 0.0), 0.0).max())
    near = f"an object comes within {max(depth_m, 0.0):.1f} m of the surface"
    if depth_m >= within:
        return Stage(False, f"no object comes within {within:g} m of the surface (least depth {depth_m:.1f} m)")
    if scene.plate.eyes == 2 and settings.objects == "auto" and depth_m > 0.0:
        return Stage(False, f"{near}; its mirror image is not drawn for both eyes")
    return stage(
        left > FAINTEST,
        f"{near}; the water leaves up to {100 * left:.0f} % of its mirror image",
        f"{near}; the water leaves {100 * left:.2g} % of its mirror image",
    )


def snow_stage(scene: Scene, medium: MediumTable | None) -> Stage:
    """Return whether particles are drawn."""
    drawn = scene.snow.amount > 0.0
    water = scene.water.water(scene.camera.depth_m) if drawn and medium is not None else None
    if water is None:
        return Stage(False, 'water is "none"' if drawn else "snow.amount is 0")
    from mr360uw.composite.snow_particles import in_words

    return Stage(*in_words(scene.snow, water))


def occlusion_stage(scene: Scene, objects: Facts) -> Stage:
    """Return whether ambient light among bodies is solved."""
    receiver = scene.receiver
    on_ground = receiver is not None and receiver.occlusion
    moving = any(facts.moves for facts in objects)
    return stage(
        bool(objects) and (scene.draw.ambient_occlusion or on_ground),
        f"ambient light among {'objects' if scene.draw.ambient_occlusion else 'none of the objects'}"
        f"{' and on the receiver' if on_ground else ''}; "
        f"{'rays between bodies in every frame that moves them' if moving else 'rays once: objects stand still'}",
        "switched off" if objects else "nothing to light",
    )


def track_sun_stage(sun: Stage, light: LightSettings, clip: bool) -> Stage:
    """Return whether the sun is followed over the clip."""
    if not sun.runs or light.sun != "detect":
        return Stage(False, "no sun" if not sun.runs else f"light.sun is {light.sun!r}")
    if not clip:
        return Stage(False, "one picture")
    if light.track is not None:
        return Stage(True, f"light.track, {light.track.name}")
    return stage(light.smooth, "in a first pass over the clip", "frame by frame: light.smooth is off")


def gain_stage(scene: Scene, visible: bool, medium: MediumTable | None) -> Stage:
    """Return whether the veil's gain is fitted."""
    water = scene.water
    return stage(
        visible and medium is not None and water.fits_gain,
        "the veil's gain is fitted to the plate" + (", and its far end to open water" if water.fits_ratio else ""),
        "no objects to veil" if not visible
        else 'water is "none"' if medium is None
        else "water.gain is given",
    )  # fmt: skip


def match_stage(scene: Scene, visible: bool) -> Stage:
    """Return whether the plate's light is read without its grade, and bodies are given its look."""
    return stage(
        visible and scene.match.changes, scene.match.in_words, "nothing to cover" if not visible else "switched off"
    )


def beam_at_objects(objects: Facts, medium: MediumTable | None) -> float:
    """Return the largest fraction of the surface's vertical beam that reaches an object, any channel."""
    if medium is None or not objects:
        return 1.0
    depth = np.array([max(facts.depth_m, 0.0) for facts in objects])
    return float(np.max(beam_fraction(medium, depth, 1.0)))


@dataclass(frozen=True, slots=True)
class Plan:
    """The stages of a scene in the order in which they run.

    track_sun, track_gain: measured in a first pass over the clip; if they do not run, measured frame by frame.
    """

    environment: Stage
    sun: Stage
    track_sun: Stage
    medium: Stage
    gain: Stage
    track_gain: Stage
    lamps: Stage
    caustics: Stage
    glossy: Stage
    shafts: Stage
    shadow: Stage
    pattern: Stage
    occlusion: Stage
    layer: Stage
    blur: Stage
    surface: Stage
    snow: Stage
    match: Stage
    grain: Stage

    @property
    def stages(self) -> dict[str, Stage]:
        """Every stage by its name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __str__(self) -> str:
        width = max(map(len, self.stages))
        rows = ((name, "runs" if stage.runs else "skipped", stage.why) for name, stage in self.stages.items())
        return "\n".join(f"  {name:<{width}}  {runs:<7}  {why}" for name, runs, why in rows)


def make_plan(
    scene: Scene, objects: Facts, medium: MediumTable | None, share: Share = None, *, clip: bool = True
) -> Plan:
    """Return the plan of a scene. medium: None where the plate has no water. clip: the plate is more than one frame.

    share: gives the fraction of the veil that is the beam scattered once (`shaft_scene.beam_share`); None: all of it.
    """
    snow = snow_stage(scene, medium)
    visible, light = bool(objects) or snow.runs, scene.light
    beam = beam_at_objects(objects, medium)
    sun = sun_stage(light, visible, beam)
    gain = gain_stage(scene, visible, medium)
    shadow = shadow_stage(scene, lit=sun.runs)
    quality = f"{scene.draw.quality} quality, {scene.draw.samples} samples a pixel"
    waves = f"{sea_in_words(scene)}; {100 * min(beam, 1):.0f} % of the beam reaches the objects"
    focuses, none = scene.caustics.enabled, "switched off" if not scene.caustics.enabled else "needs a sun and water"
    caustics = stage(sun.runs and medium is not None and focuses, waves, none)
    return Plan(
        environment=stage(visible, f"{'objects are' if objects else 'snow is'} lit by the plate", "nothing to light"),
        sun=sun,
        track_sun=track_sun_stage(sun, light, clip),
        medium=stage(medium is not None, scene.water.label, 'water is "none"'),
        gain=gain,
        track_gain=stage(
            gain.runs and clip and light.smooth,
            "in a first pass over the clip",
            "nothing to fit" if not gain.runs else "frame by frame: light.smooth is off" if clip else "one picture",
        ),
        lamps=stage(visible and len(scene.lamps) > 0, f"{len(scene.lamps)} of the scene", "the scene has none"),
        caustics=caustics,
        glossy=stage(
            visible and any(facts.glossy for facts in objects),
            "a material is smoother than diffuse",
            "every material is diffuse" if visible else "nothing to light",
        ),
        shafts=shafts_stage(scene, objects, medium, share, lit=sun.runs, waves=caustics.runs),
        shadow=shadow,
        pattern=stage(
            shadow.runs and medium is not None,
            "shadows take the plate's own caustics away",
            "no shadow" if not shadow.runs else 'water is "none"',
        ),
        occlusion=occlusion_stage(scene, objects),
        layer=stage(
            visible,
            "no objects, but snow" if not objects
            else f"{quality}; objects "
            + ("move" if any(o.moves for o in objects) else "stand still: geometry is kept between frames"),
            "no objects: the plate goes through untouched",
        ),
        blur=blur_stage(scene, objects, medium),
        surface=surface_stage(scene, objects, medium),
        snow=snow, match=match_stage(scene, visible),
        grain=stage(
            visible and scene.draw.grain > 0.0,
            f"objects get {100 * scene.draw.grain:.0f} % of the plate's grain",
            "draw.grain is 0" if visible else "nothing to cover",
        ),
    )  # fmt: skip


def joined_plan(plans: Sequence[Plan]) -> Plan:
    """Return the plan of a scene over time: a stage runs if it runs in one of the plans, for the reason that has."""
    stages = {
        name: next((plan.stages[name] for plan in plans if plan.stages[name].runs), stage)
        for name, stage in plans[0].stages.items()
    }
    return Plan(**stages)


def sea_in_words(scene: Scene) -> str:
    """Return the kind of a sea, its grid, and the waves that it does not draw, as the plan shows them."""
    sea, slope = scene.sea, scene.sea.detail_rms_slope
    drawn = f"{sea.model} sea, grid {grid_of(scene.caustics, sea)}"
    if slope == 0.0:
        return drawn
    source = "as set" if sea.detail_slope is not None else f"Cox & Munk at {sea.wind_speed:g} m/s"
    effect = "blur" if sea.detail_kind == "blur" else "ripples"
    return f"{drawn}; other waves as {effect}, rms slope {slope:.3f} ({source})"


# --- Depths of caustics ---------------------------------------------------------------------------------------------

# Depth planes and map size of a scene's caustics, chosen from the depths that its objects reach over the clip.


_WATER_LADDER = PlaneLadder(first=0.5, step=2.0)
"""Planes of the water itself, every second one of those around objects: rays cross several and average over them. The
first is 0.13 m deep."""
_WATER_SIZE = 256
"""Most pixels across the maps of these planes. Twice as many: no visible difference, in twice the time."""
_SHALLOWEST_M = 0.15
"""Depth [m] above which waves have not focused light yet: contrast grows linearly from the surface."""
_OVERHEAD = np.array([0.0, 1.0, 0.0])
"""Direction of the sun under which short waves blur least."""


@dataclass(frozen=True, slots=True)
class CausticDepths:
    """Depth planes of a scene's caustics, and its settings with the map size reduced to what the frame resolves.

    ground: depth range of a receiver that is no plane and shows caustics, or None. snow_m: distance from the camera up
    to which particles need planes; 0 beside objects, whose planes particles take. shadows: whether bodies cast any on
    the ground; level_m: its depth, None where it is no plane.
    """

    ladder: PlaneLadder
    ground: Span | None
    settings: CausticSettings
    snow_m: float = 0.0
    shadows: bool = False
    level_m: float | None = None

    @classmethod
    def of(
        cls,
        scene: Scene,
        objects: tuple[SceneObject, ...],
        receiver: Receiver | None,
        camera: CameraPath,
        frame_height: int,
        *,
        relief: bool = False,
    ) -> CausticDepths:
        """Return the planes and settings of a scene. receiver: None if its shape is a map, known in each frame alone.

        relief: whether it has the plate's relief, which is taken to rise from it to the height of the camera.
        """
        settings, surface = scene.caustics, scene.camera.depth_m
        cameras = _positions(camera)
        nearest = [_nearest(placed, cameras) for placed in objects]
        reaches, heights = [], []
        for placed in objects:
            levels = surface - _levels(placed, cameras)
            reaches.append((float(levels.min()), float(levels.max())))
            heights.append(float(np.ptp(levels, axis=1).max()))
        flat: list[float] = []
        levels_y: list[float] = []
        ground: Span | None = None
        if scene.receiver is not None and scene.receiver.caustics:
            nearest.append(0.0)
            if receiver is not None and receiver.plane_y is not None:
                flat.append(surface - receiver.plane_y)
                levels_y = [receiver.plane_y]
                nearest[-1] = 0.0 if relief else float(np.min(np.abs(cameras[:, 1] - receiver.plane_y)))
            elif receiver is not None and receiver.mesh is not None:
                levels_y = [float(receiver.mesh[..., 1].min()), float(receiver.mesh[..., 1].max())]
            levels_y += [float(cameras[:, 1].max())] if relief else []
            if len(levels_y) > 1:
                ground = surface - max(levels_y), surface - min(levels_y)
                reaches.append(ground)
                heights.append(ground[1] - ground[0])
        snow_m = scene.snow.range_m if scene.snow.amount > 0.0 and not objects else 0.0
        if snow_m > 0.0:
            depths = surface - cameras[:, 1]
            nearest.append(NEAREST_M)
            reaches.append((float(depths.min()) - snow_m, float(depths.max()) + snow_m))
            heights.append(2.0 * snow_m)
        shallowest = max(min([*(reach[0] for reach in reaches), *flat], default=0.0), 0.0)
        blurred = detail_footprint(_OVERHEAD, scene.water.refractive_index, scene.sea.blur_slope, shallowest)
        size = map_size(
            settings.size, scene.sea.tile_m, max(min(nearest, default=0.0), 0.0) * np.pi / frame_height,
            shallowest * settings.sun_half_angle_rad / scene.water.refractive_index,
            float(np.linalg.norm(blurred, -2)),
        )  # fmt: skip
        ladder = PlaneLadder.of_scene(reaches, heights, flat, settings.planes)
        shadows = scene.receiver is not None and scene.receiver.shadow and settings.method == "exact"
        plane_y = None if receiver is None else receiver.plane_y
        level_m = None if plane_y is None else surface - plane_y
        return cls(ladder, ground, settings.model_copy(update={"size": size}), snow_m, shadows, level_m)

    def water_planes(self, shot: Shot, deepest_m: float) -> Floats:
        """Return the depths (n,) [m] of the planes of the water between the camera and a shot's objects, ascending.

        deepest_m: depth that they reach at least, then from the surface; 0: none.
        """
        camera = shot.view.surface_y_m - float(shot.view.position[1])
        depths = [camera, *((_SHALLOWEST_M, deepest_m) if deepest_m > 0.0 else ())]
        for placed in shot.objects:
            levels = shot.view.surface_y_m - placed.to_world(placed.mesh.hull)[..., 1]
            depths += [float(levels.min()), float(levels.max())]
        span = tuple(max(depth, _SHALLOWEST_M) for depth in (min(depths), max(depths)))
        return _WATER_LADDER.around([(span[0], span[1])])

    def shadow_m(self, shot: Shot) -> float | None:
        """Return the depth [m] of the ground that a shot's shadows fall on, that of the lowest body where it is not
        level; None where none do.
        """
        if not self.shadows or not shot.casters:
            return None
        if self.level_m is not None:
            return self.level_m
        lowest = min(float(placed.to_world(placed.mesh.hull)[..., 1].min()) for placed in shot.casters)
        return max(shot.view.surface_y_m - lowest, 0.0)

    @property
    def of_water(self) -> CausticSettings:
        """The settings of the caustics in the water itself: rays average over more than a pixel of their maps."""
        return self.settings.model_copy(update={"size": min(self.settings.size, _WATER_SIZE)})

    def planes(self, shot: Shot) -> Floats:
        """Return the depths (n,) [m] of the planes that a shot needs, ascending."""
        spans = [] if self.ground is None else [self.ground]
        for placed in shot.objects:
            depth = shot.view.surface_y_m - placed.to_world(placed.mesh.hull)[..., 1]
            spans.append((float(depth.min()), float(depth.max())))
        if self.snow_m > 0.0:
            depth_m = shot.view.surface_y_m - float(shot.view.position[1])
            spans.append((max(depth_m - self.snow_m, 0.0), depth_m + self.snow_m))
        return self.ladder.around(spans)


def _positions(camera: CameraPath) -> Floats:
    """Return positions (n, 3) whose bounding box contains the camera at all times."""
    if camera.track is not None:
        return camera.track.position
    return np.stack([0.0 * camera.depths, camera.depth_m - camera.depths, 0.0 * camera.depths], axis=-1)


def _levels(placed: SceneObject, cameras: Floats) -> Floats:
    """Return the heights (n, 2) [m] of the lowest and highest point of an object at each of its keys.

    Between keys it may reach beyond them. Then a frame has more planes; the result is still right.
    """
    hull = np.concatenate([mesh.hull.reshape(-1, 3) for mesh in placed.meshes])
    poses = [placed.motion.at(time_s) for time_s in placed.motion.time_s.tolist()]
    rows = [hull @ pose[1, :3] + pose[1, 3] for pose in poses]
    levels = np.array([(row.min(), row.max()) for row in rows])
    if placed.settings.attach == "camera":
        return np.concatenate([levels + cameras[:, 1].min(), levels + cameras[:, 1].max()])
    return levels


def _nearest(placed: SceneObject, cameras: Floats) -> float:
    """Return a lower bound [m] of an object's distance from the camera; it may be negative.

    Between keys, positions and scales stay between those of the keys.
    """
    motion = placed.motion
    reach = float(motion.scale.max()) * max(float(np.linalg.norm(m.center_m)) + m.radius_m for m in placed.meshes)
    if placed.settings.attach == "camera":
        cameras = np.zeros((1, 3))
    low, high = motion.position.min(axis=0), motion.position.max(axis=0)
    apart = np.maximum(low - cameras.max(axis=0), cameras.min(axis=0) - high)
    return float(np.linalg.norm(np.maximum(apart, 0.0))) - reach
