# SPDX-License-Identifier: Apache-2.0
"""Pictures of a shallow sea by a camera in the air, and the files and films that are made of them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import ColorSpec
from mr360uw.base.constants import CLEAR_SKY_B, CLEAR_SKY_G, CLEAR_SKY_R, LUMINANCE_B, LUMINANCE_G, LUMINANCE_R, PI
from mr360uw.base.files import check_outputs, is_pattern, matching_files, numbered
from mr360uw.base.input_files import FRAMES, files_read
from mr360uw.base.parameters import checked
from mr360uw.base.progress import Progress
from mr360uw.base.sphere import direction_from_angles, directions, row_solid_angle, yaw_matrix
from mr360uw.composite.shot import Receiver, load_objects, on_the_floor, on_the_sea
from mr360uw.composite.tiles import over
from mr360uw.errors import OutputExistsError, ParameterError
from mr360uw.from_above.aerial_bodies import AerialBodies, FloorSeen, brightened, reflected_radiance
from mr360uw.from_above.settings import AerialFloorSettings, AerialScene, AerialWaterSettings
from mr360uw.ibl.tilt import level_matrix
from mr360uw.medium import Medium, Water
from mr360uw.medium.medium import RGB_NM, Mode
from mr360uw.medium.models import FormationModel
from mr360uw.medium.spectra import named_sensor
from mr360uw.published import blended_albedo, thresholded_reflection
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.rendered_dive import sea_bed
from mr360uw.scene.model import files_of
from mr360uw.surface import Floor, SeaScene, SurfacePicture
from mr360uw.surface.sea_picture import rendered
from mr360uw.surface.sky import CLEAR, OVERCAST, standard_sky
from mr360uw.types import Array, Floats, Layer, Sun, View
from mr360uw.video import VideoFrame, create_video
from mr360uw.video.clip import PICTURE_SUFFIXES, Clip
from mr360uw.video.exr import Part, write_exr
from mr360uw.video.opening import open_video
from mr360uw.video.picture_file import read_picture


@dataclass(frozen=True, slots=True, eq=False)
class AerialPicture:
    """A picture from above.

    image_linear: (H, W, 3) float32, linear Rec.709, times the exposure: a level white card on the shore has the value
    of `camera.exposure`. What follows is of the ray through each pixel's centre at its first meeting with the waves;
    radiances are exposed too.
    normal: (H, W, 3) of the surface, +y up, zero where there is none. floor_radiance: (H, W, 3) that leaves the floor
    on the refracted ray, before water and surface take their part, or on the ray itself where it is dry; zero
    elsewhere. reflection: (H, W, 3) that the surface mirrors. distance_m: (H, W) to the surface or the dry floor,
    infinity for the sky. in_water_m: (H, W) length of the refracted ray down to the floor, 0 where there is none.
    body_alpha: (H, W) fraction of each pixel that bodies cover; the other arrays are without them. view: the camera.
    time_s: of the picture.
    """

    image_linear: NDArray[np.float32]
    normal: Floats
    floor_radiance: Floats
    reflection: Floats
    distance_m: Floats
    in_water_m: Floats
    body_alpha: Floats
    view: View
    time_s: float


@dataclass(frozen=True, slots=True, eq=False)
class LoadedAerial:
    """A scene with its files read and its water solved, for any number of pictures.

    sea: without bodies. exposure: factor on radiance. bodies: None where there are none.
    """

    scene: AerialScene
    sea: SeaScene
    exposure: float
    bodies: AerialBodies | None = None

    @classmethod
    @checked
    def of(cls, scene: AerialScene) -> LoadedAerial:
        """Return it; raise `ParameterError`, `VideoError` or `MeshError` for files that cannot be used."""
        sea = _sea_scene_of(scene)
        light = np.asarray(sea.dome.irradiance, np.float64)
        if sea.sun is not None:
            light = light + sea.sun.irradiance * max(float(sea.sun.direction[1]), 0.0)
        level = float(light @ np.array([LUMINANCE_R, LUMINANCE_G, LUMINANCE_B]))
        if not level > 0.0:
            raise ParameterError("sun, sky - give no light (got 0) - set sun.irradiance or sky.irradiance")
        ground = Receiver(plane_y=-scene.floor.depth_m)
        afloat = tuple(on_the_floor(on_the_sea(one, sea.sea, 0.0), ground) for one in load_objects(scene.objects))
        bodies = AerialBodies(sea, afloat) if afloat else None
        return cls(scene, sea, scene.camera.exposure * PI / level, bodies)

    def view(self, time_s: float = 0.0, size: tuple[int, int] | None = None) -> View:
        """Return the camera at a time [s]. size: (width, height) of the picture instead of the scene's."""
        camera = self.scene.camera
        width, height = size or (camera.width, camera.height)
        if min(width, height) < 1:
            raise ParameterError(f"size - must be 1 or more pixels (got {width}x{height}) - give (1280, 720)")
        position = np.array(camera.position_m) + time_s * np.array(camera.velocity_m_s)
        turned = yaw_matrix(math.radians(camera.yaw_deg + time_s * camera.turn_deg_s))
        tilt = level_matrix(math.radians(camera.roll_deg), math.radians(camera.pitch_deg))
        return View(
            width, height, position, turned @ tilt, 0.0, camera.projection,
            math.radians(camera.fov_deg), camera.width_m,
        )  # fmt: skip

    def picture(self, time_s: float = 0.0, size: tuple[int, int] | None = None) -> AerialPicture:
        """Return the picture at a time [s], the same alone and within a film; see `view`."""
        view, samples = self.view(time_s, size), self.scene.film.samples
        seen, below, mirrored, layer = self._seen(view, time_s, samples)
        image = np.asarray(over(seen.radiance, layer), np.float64)
        e = self.exposure
        return AerialPicture(
            (e * image).astype(np.float32), seen.normal, e * below, e * mirrored, seen.distance_m, seen.in_water_m,
            layer.alpha, view, time_s,
        )  # fmt: skip

    def layer(self, time_s: float = 0.0, size: tuple[int, int] | None = None) -> Layer:
        """Return the bodies alone at a time [s], exposed, as a layer over a picture of the same view."""
        *_, layer = self._seen(self.view(time_s, size), time_s, 1)
        return brightened(layer, self.exposure)

    def _seen(self, view: View, time_s: float, samples: int) -> tuple[SurfacePicture, Array, Array, Layer]:
        """Return the sea without bodies, the radiances (H, W, 3) that leave the floor and that the surface mirrors, and
        the bodies over them.
        """
        # A thresholded reflection of the sun is laid over a sea that does not mirror it
        stage, reflection = self.sea.stage(view, time_s, samples * samples), self.scene.reflection
        apart = reflection.sun == "thresholded"
        mirroring = replace(stage, sun=None) if apart else stage
        seen = rendered(mirroring, view, samples)
        # Follow the rays through the pixels' centres to the floor, and by the surface to the sky
        x, y = np.arange(view.width) + 0.5, np.arange(view.height)[:, None] + 0.5
        directions, origins = (np.asarray(rays(x, y), np.float64) for rays in (view.directions, view.origins))
        floor = FloorSeen(stage, view, seen, directions, origins)
        mirrored = reflected_radiance(mirroring, view, seen, directions)
        if apart and self.sea.sun is not None and not seen.camera_in_water:
            part = thresholded_reflection(directions, seen.normal, self.sea.sun, math.radians(reflection.threshold_deg))
            sharp = part[..., None] * (reflection.gain * self.sea.sun.irradiance)
            seen, mirrored = replace(seen, radiance=seen.radiance + sharp), mirrored + sharp
        # Light the bodies; meshes may change from frame to frame
        layer = Layer(view.height, view.width, ())
        if self.bodies is not None:
            frame = round(time_s * self.scene.film.frame_rate)
            layer = self.bodies.layer(stage, view, floor, mirrored, time_s, frame, self.scene.caustics)
        return seen, floor.radiance, mirrored, layer


@checked
def aerial(scene: AerialScene, *, time_s: float = 0.0, size: tuple[int, int] | None = None) -> AerialPicture:
    """Return a picture of the sea from the air.

    The floor is seen through moving waves, with caustics and the mirrored sky. A level white card on the shore has the
    value of `camera.exposure`.

    Parameters
    ----------
    scene : AerialScene
        The scene, of `load_aerial`, or made from its tables.
    time_s : float
        Time [s] of the sea.
    size : tuple of int, optional
        Width and height in pixels instead of the camera's.

    Returns
    -------
    AerialPicture
        Linear light `image_linear` (H, W, 3), distances and masks.

    Raises
    ------
    ParameterError
        If the scene cannot be seen, as from below the floor.
    VideoError
        If its sky cannot be read.

    See Also
    --------
    uw.load_aerial : Reads the scene.
    uw.from_above.LoadedAerial : Keeps what does not change, for several pictures.
    uw.from_above.aerial_film : Writes pictures or a video.

    Examples
    --------
    >>> above = uw.AerialScene(caustics={"size": 64, "grid": 64}, sea={"resolution": 32})
    >>> uw.aerial(above, size=(16, 8)).image_linear.shape
    (8, 16, 3)
    """
    return LoadedAerial.of(scene).picture(time_s, size)


# Floor, water, sea and sky of a scene's settings, as pictures through the surface take them.

_MOST_ROWS = 512
"""Rows that maps are reduced to: what waves mirror is blurred more."""
_SHAPES = {"overcast": OVERCAST, "clear": CLEAR}
_SHARE = {"overcast": 0.5, "clear": 0.2}
"""Irradiance of level ground over that of the sun's beam across itself. A clear sky gives 10 to 20 % of all light with
the sun high."""


def sun_of(scene: AerialScene) -> Sun | None:
    """Return the sun of a scene; None where it has none."""
    given = scene.sun.irradiance
    irradiance = np.full(3, 1.0 if scene.sky.kind == "clear" else 0.0) if given is None else np.array(given)
    if not np.any(irradiance > 0.0):
        return None
    return Sun(_sun_direction(scene), irradiance, scene.sun.half_angle_rad, 1.0)


def _sky_of(scene: AerialScene) -> Array:
    """Return the radiance (h, 2 h, 3) of a scene's sky, without its sun; raise `VideoError` for maps that cannot be
    read.
    """
    sky = scene.sky
    if sky.kind == "map":
        assert sky.map is not None
        return _scaled(_map(sky.map, sky.turn_deg), sky.irradiance)
    color = np.array([CLEAR_SKY_R, CLEAR_SKY_G, CLEAR_SKY_B]) if sky.kind == "clear" else np.ones(3)
    dome = standard_sky(_SHAPES[sky.kind], _sun_direction(scene))
    return _scaled(dome[..., None] * color, _SHARE[sky.kind] if sky.irradiance is None else sky.irradiance)


def _sun_direction(scene: AerialScene) -> Array:
    return direction_from_angles(math.radians(scene.sun.azimuth_deg), math.radians(scene.sun.elevation_deg))


def _map(path: Path, turn_deg: float) -> Array:
    """Return the radiance (h, 2 h, 3) of a picture of the sky, turned to the right."""
    import cv2

    light = _light(path)
    rows = min(max(light.shape[0] // 2 * 2, 2), _MOST_ROWS)
    light = np.asarray(cv2.resize(light, (2 * rows, rows), interpolation=cv2.INTER_AREA), np.float64)
    light = np.maximum(np.nan_to_num(light, posinf=0.0, neginf=0.0), 0.0)
    return np.roll(light, round(turn_deg / 360.0 * 2 * rows), axis=1)


def _light(path: Path) -> Array:
    """Return the linear Rec.709 light (h, w, 3) of a picture, by its profile or its primaries where it states any."""
    with open_video(path, equirectangular=False) as picture:
        return np.asarray(next(picture.frames(1)).image_linear, np.float64)


def _scaled(dome: Array, irradiance: float | None) -> Array:
    """Return a dome with a mean irradiance of level ground; the dome itself for None or a dark one."""
    height, width = dome.shape[:2]
    weight = row_solid_angle(width, height) * np.maximum(directions(width, height)[:, 0, 1], 0.0)
    total = float(np.mean(np.einsum("hwc,h->c", dome, weight)))
    return dome if irradiance is None or total <= 0.0 else dome * (irradiance / total)


_SEEN_FROM_M = 0.01
"""Depth [m] of the medium's camera, just below the surface."""
_MOST_PIXELS = 2048
"""Side that pictures of the ground are reduced to."""
_SAND_SEED = 1


def _sea_scene_of(scene: AerialScene) -> SeaScene:
    """Return a scene with its water solved and its files read; raise `ParameterError` or `VideoError`."""
    index, sea = scene.water.refractive_index, scene.sea
    if "water_depth_m" not in sea.model_fields_set:
        sea = sea.model_copy(update={"water_depth_m": scene.floor.depth_m})  # waves feel the scene's floor
    return SeaScene(
        sea, _sky_of(scene), floor_of(scene.floor, scene.water), water_of(scene.water), sun=sun_of(scene),
        refractive_index=index, caustics=scene.caustics,
    )  # fmt: skip


def floor_of(floor: AerialFloorSettings, water: AerialWaterSettings) -> Floor:
    """Return the floor with its picture, mixed with the water's colour in mode blended."""
    albedo = np.broadcast_to(np.asarray(floor.albedo, np.float64), (3,))
    image: Array = albedo[None, None]
    if floor.ground == "sand":
        sand = sea_bed(DiveSettings(seed=_SAND_SEED, rocks=0.0, grass=0.0))[1]
        image = sand / sand.mean(axis=(0, 1)) * albedo
    elif floor.ground == "picture":
        assert floor.picture is not None
        image = _square(_light(floor.picture)) * albedo
    image = np.clip(image, 0.0, 1.0)
    if water.mode == "blended":
        per_m, color = blend_of(water)
        image = blended_albedo(image, floor.depth_m, per_m, color)
    if floor.relief is None:
        return Floor(-floor.depth_m, image, floor.tile_m)
    heights = floor.relief_m * _square(_heights(floor.relief))
    return Floor(-floor.depth_m, image, floor.relief_tile_m, relief=heights, albedo_tile_m=floor.tile_m)


def _heights(path: Path) -> Array:
    """Return heights (h, w), black 0 and white 1, of a picture; those of EXR and HDR files as they are."""
    codes = read_picture(path)
    scale = 1.0 if codes.dtype.kind == "f" else float(np.iinfo(codes.dtype).max)
    return codes.mean(axis=-1, dtype=np.float64) / scale


def water_of(settings: AerialWaterSettings) -> Medium | None:
    """Return the medium of a scene; None for clear water, which mode blended has too."""
    water = settings.water()
    if water is None or settings.mode == "blended":
        return None
    if settings.mode != "koschmieder":
        return _medium(settings, water, settings.mode)
    beta = np.array(settings.attenuation_per_m or water.attenuation(np.array(RGB_NM)))
    far = _deep_radiance(settings, water) if settings.far_radiance is None else np.array(settings.far_radiance)
    formation = FormationModel(beta, np.asarray(water.diffuse_attenuation(np.array(RGB_NM))), beta, far)
    return _medium(settings, water, "koschmieder", formation)


def blend_of(settings: AerialWaterSettings) -> tuple[Array, Array]:
    """Return k (3,) [1/m] and the colour (3,) of mode blended."""
    water = settings.water()
    per_m, color = settings.blend_per_m, settings.blend_color
    if water is None:
        return np.array(per_m or (0.0, 0.0, 0.0)), np.array(color or (0.0, 0.0, 0.0))
    k = 2.0 * water.diffuse_attenuation(np.array(RGB_NM)) if per_m is None else np.array(per_m)
    own = np.clip(PI * _deep_radiance(settings, water), 0.0, 1.0) if color is None else np.array(color)
    return np.asarray(k), own


def _medium(settings: AerialWaterSettings, water: Water, mode: Mode, formation: FormationModel | None = None) -> Medium:
    return Medium(
        water, named_sensor(str(settings.sensor)), mode, _SEEN_FROM_M, illuminant=settings.illuminant,
        refractive_index=settings.refractive_index, formation=formation,
    )  # fmt: skip


def _deep_radiance(settings: AerialWaterSettings, water: Water) -> Array:
    """Return the radiance (3,) [1/sr] that comes up from deep water per unit irradiance just below the surface."""
    return np.asarray(_medium(settings, water, "table").level_radiance(np.array([-1.0]))[0])


def _square(image: Array) -> Array:
    """Return a picture as a square whose side is a power of two, which repeats as the picture does."""
    import cv2

    side = 2 ** round(math.log2(min(max(image.shape[:2]), _MOST_PIXELS)))
    return np.asarray(cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA))


# --- files and films ------------------------------------------------------------------------------------------------

# Files of pictures from above: a still, numbered pictures, EXR files with parts, a video.
#
# Bodies are laid into pictures or a video that a real camera took from the air where the scene names a plate. It says
# where the camera was, what its lens is, and what sea, water, sky and sun were there. The waves of the scene move the
# bodies' images; they are as steep as the real ones, not the same. The plate gives its own size.


_MATCH_COLUMNS = 96
"""Columns of the picture of the scene's sea that is compared with the plate: medians are the same with twice as many
within 1 %."""


def plate_gain(loaded: LoadedAerial, plate_linear: Floats) -> Array:
    """Return the factor (3,) on the scene's light that gives its own picture of the sea the plate's median colour."""
    height, width = plate_linear.shape[:2]
    columns = min(_MATCH_COLUMNS, width)
    bare = replace(loaded, bodies=None)
    sea = bare.picture(0.0, (columns, max(round(columns * height / width), 1))).image_linear
    ours, plate = (np.median(image.reshape(-1, 3), axis=0) for image in (sea, plate_linear))
    return np.asarray(plate / np.maximum(ours, 1e-9), np.float64)


def _write_onto_plate(
    scene: AerialScene, path: Path, frames: tuple[int, int | None], *, overwrite: bool, progress: Progress | None
) -> int:
    """Write a plate with bodies and return the number of frames; see `aerial_film`.

    What the bodies do not touch keeps its codes.
    """
    assert scene.plate is not None
    around = scene.camera.projection == "equirectangular"
    with open_video(scene.plate.path, scene.plate.transfer, equirectangular=around) as plate:
        start, stop = plate.numbered_range(*frames)
        with create_video(path, plate, scene.output, overwrite=overwrite) as writer:
            # Scale the scene's light to the plate's, then lay the bodies over each frame
            loaded, gain = LoadedAerial.of(scene), np.ones(3)
            if scene.plate.match:
                gain = plate_gain(loaded, next(iter(plate.frames(0, 1))).image_linear)
            for frame in plate.frames(start, stop):
                layer = brightened(loaded.layer(frame.time_s, (plate.width, plate.height)), gain)
                writer.write(frame.over(layer, scene.plate.grain))
                if progress is not None:
                    progress(frame.index - start + 1, stop - start)
    return stop - start


Write = Callable[[int, AerialPicture], None]
"""Takes the number of a frame and its picture."""


@dataclass(frozen=True, slots=True)
class AerialReport:
    """Files that were written. seconds: wall time."""

    out: Path
    frames: int
    seconds: float

    def __str__(self) -> str:
        count = f"{self.frames} frame" + "s" * (self.frames != 1)
        return f"wrote {self.out}: {count} in {self.seconds:.1f} s ({self.seconds / self.frames:.2f} s each)"


@checked
def aerial_film(
    scene: AerialScene,
    out: str | Path,
    *,
    frames: tuple[int, int | None] = (0, None),
    overwrite: bool = False,
    progress: Progress | None = None,
) -> AerialReport:
    """Write pictures of a scene and return a report.

    out: a picture (.png, .jpg, .exr ...: the first frame), a pattern of pictures (sea_%04d.exr) or a video (.mp4, .mov,
    .mkv, .webm). EXR files have the parts of `picture_parts`. frames: [start, stop); None: to the film's end. A scene
    with a plate puts its bodies into that, without parts.

    Each file appears when it is complete. Raises `ParameterError`, `VideoError` and `OutputExistsError`.
    """
    began = time.perf_counter()
    path, rate = Path(out), Fraction(scene.film.frame_rate).limit_denominator(1001)
    check_outputs([path], inputs=files_of(scene), overwrite=overwrite)
    if scene.plate is not None:
        done = _write_onto_plate(scene, path, frames, overwrite=overwrite, progress=progress)
        return AerialReport(path, done, time.perf_counter() - began)
    start, stop = _range(scene, path, frames, rate)
    with _output(scene, path, rate, overwrite) as write:
        with files_read() as read:
            loaded = LoadedAerial.of(scene)
        check_outputs([path], inputs=read, overwrite=True)  # textures and the like, which only meshes name
        for index in range(start, stop):
            write(index, loaded.picture(float(index / rate)))
            if progress is not None:
                progress(index - start + 1, stop - start)
    return AerialReport(path, stop - start, time.perf_counter() - began)


@checked
def picture_parts(picture: AerialPicture) -> dict[str, Part]:
    """Return the parts of an EXR file, float32: beauty, normal (N.X, N.Y, N.Z), floor, reflection, distance (Z), water
    (Z: length in the water), bodies (A: what they cover). See `AerialPicture`.
    """
    light = {"beauty": picture.image_linear, "floor": picture.floor_radiance, "reflection": picture.reflection}
    lengths = {"distance": picture.distance_m, "water": picture.in_water_m}
    parts: dict[str, Part] = {name: {"RGB": np.asarray(image, np.float32)} for name, image in light.items()}
    parts["normal"] = {f"N.{axis}": np.asarray(picture.normal[..., k], np.float32) for k, axis in enumerate("XYZ")}
    parts["bodies"] = {"A": np.asarray(picture.body_alpha, np.float32)}
    return parts | {name: {"Z": np.asarray(length, np.float32)} for name, length in lengths.items()}


def _range(scene: AerialScene, path: Path, frames: tuple[int, int | None], rate: Fraction) -> tuple[int, int]:
    """Return the frames [start, stop) that an output takes."""
    start, stop = frames
    if path.suffix.lower() in PICTURE_SUFFIXES and not is_pattern(path):
        if stop is not None and stop != start + 1:
            raise ParameterError(
                f"{path} - one picture cannot hold several frames (got {start}:{stop}) - name a pattern such as "
                f"{path.stem}_%04d{path.suffix}"
            )
        return start, start + 1
    count = max(round(scene.film.duration_s * rate), 1)
    stop = count if stop is None else stop
    if not 0 <= start < stop <= count:
        raise ParameterError(
            f"frames - outside of the film (got {start}:{stop}) - it has {count}; film.duration_s makes it longer"
        )
    FRAMES.check("frames", stop - start, ParameterError)
    return start, stop


@contextmanager
def _output(scene: AerialScene, path: Path, rate: Fraction, overwrite: bool) -> Iterator[Write]:
    """Yield a function that writes frames of a scene; the output is complete afterwards, or absent."""
    # EXR: a file of parts for each picture
    around = scene.camera.projection == "equirectangular"
    if path.suffix.lower() == ".exr":
        there = matching_files(path)[:1] if is_pattern(path) else []
        if there and not overwrite:
            raise OutputExistsError(f"{there[0][1]} - is already there - choose another name or allow overwriting")

        def write_parts(index: int, picture: AerialPicture) -> None:
            name = numbered(path, index) if is_pattern(path) else path
            write_exr(name, picture_parts(picture), latlong=around)

        yield write_parts
        return
    # All else is a video or pictures, as composites are written
    camera = scene.camera
    if path.suffix.lower() not in PICTURE_SUFFIXES and (camera.width % 2 or camera.height % 2):
        raise ParameterError(
            f"camera.width, camera.height - must be even for a video (got {camera.width}x{camera.height}) - add a pixel"
        )
    like = Clip(
        path=Path(), width=camera.width, height=camera.height, frame_rate=rate, time_base=1 / rate, panorama=around
    )
    with create_video(path, like, scene.output, overwrite=overwrite) as writer:
        spec = ColorSpec("bt709", True, "linear", 32)

        def write(index: int, picture: AerialPicture) -> None:
            time_s = float(index / rate)
            writer.write(VideoFrame(index, index, 1 / rate, time_s, 1, spec, rgb=picture.image_linear, wrap=around))

        yield write
