# SPDX-License-Identifier: Apache-2.0
"""A synthetic 360 dive as files: clip, mesh, scene file, and the sun, sea, water and depths that made it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import ColorSpec, Transfer, encode, luminance, ycbcr_from_rgb
from mr360uw.base.files import check_folder, check_outputs, made_folder, whole_file, write_whole
from mr360uw.base.input_files import FRAMES, PICTURE
from mr360uw.base.parameters import checked, file_path, instance
from mr360uw.base.progress import Progress, Steps, one_blas_thread, prefetch
from mr360uw.errors import ParameterError
from mr360uw.medium import Water
from mr360uw.sample.dive_settings import DiveSettings
from mr360uw.sample.rendered_dive import BED_TILE_M, SENSOR, Dive
from mr360uw.surface.sea_picture import SurfacePicture
from mr360uw.types import Floats, YuvImage

TRACK = "camera.csv"
"""Name of the file with the camera's motion, beside the scene, where the camera moves."""
TRUTH_FOLDER = "truth"
"""Name of the folder with the frames' distances and masks."""
_CALF_M = 4.0
"""Length of the whale: a newborn humpback, which is near enough over sand to catch the caustics whole."""
_FINE = 512
"""Pixels across a frame from which on the whale is fine and swims: in smaller frames, for quick tries, a coarse, rigid
one looks the same."""


@dataclass(frozen=True, slots=True)
class SampleDive:
    """The files of a sample dive. truth: JSON of `dive_truth`; beside it is the folder `truth` with .npz files."""

    plate: Path
    mesh: Path
    scene: Path
    truth: Path


@checked
def sample_dive(
    folder: str | Path,
    settings: DiveSettings | None = None,
    *,
    width: int = 1024,
    frames: int = 48,
    frame_rate: Fraction = Fraction(24),
    seed: int = 1,
    samples: int = 1,
    truth: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> SampleDive:
    """Make a folder with a synthetic 360 clip (sound, spherical metadata), a whale, a scene file and the truth.

    For a first try without footage, and for checks against a light, a water and a camera that are known. Frames are
    rendered by rays through moving waves.

    Parameters
    ----------
    folder : str or Path
        Folder of the files, which is made.
    settings : DiveSettings, optional
        Water, sun, sea and floor of the dive.
    width : int
        Pixels across the frame, a multiple of 4; the height is half of it.
    frames : int
        Length of the clip.
    frame_rate : Fraction
        Frames a second.
    seed : int
        Seed of sea, floor and noise, without settings.
    samples : int
        Rays of a pixel along each axis.
    truth : bool
        Distances and masks of every frame, not of the first alone.
    overwrite : bool
        Replace files that are there.
    progress : callable, optional
        Is called with (done, total) frames.

    Returns
    -------
    SampleDive
        Paths of the plate, the mesh, the scene and the truth.

    Raises
    ------
    ParameterError
        If a setting is out of range.
    OutputExistsError
        If files are there already.
    VideoError
        If the clip cannot be written.

    See Also
    --------
    uw.load_scene : Reads the scene file.
    uw.surface.SeaScene : Renders pictures of a sea in memory.

    Examples
    --------
    >>> dive = uw.sample_dive("try", width=64, frames=1)
    >>> dive.scene.name
    'scene.toml'
    """
    from mr360uw.scene.handbook import scene_text

    # Refuse wrong numbers, and files that are there already, before anything is made
    settings = DiveSettings(seed=seed) if settings is None else instance("settings", settings, DiveSettings, "make one")
    check_recording(width, frames, samples)
    folder = file_path("folder", folder)
    made = SampleDive(folder / "dive.mp4", folder / "whale.glb", folder / "scene.toml", folder / "truth.json")
    outputs = [made.plate, made.mesh, made.scene, made.truth, *([folder / TRACK] if settings.moves else [])]
    check_outputs(outputs, overwrite=overwrite, folder=folder)
    check_folder(folder / TRUTH_FOLDER)
    # Render a frame at a time, while the one before is encoded
    dive = Dive(settings, width, width // 2, samples=samples)
    times = [float(index / frame_rate) for index in range(frames)]

    def image(index: int) -> Floats:
        seen = dive.picture(times[index])
        if truth or index == 0:
            write_frame_truth(folder / TRUTH_FOLDER / f"{index:05d}.npz", dive, seen)
        light = (dive.exposure * seen.radiance).astype(np.float32)
        return with_noise(light, settings.noise, settings.seed, index)

    def images() -> Iterator[Floats]:
        steps = Steps(progress, frames)
        for light in prefetch(map(image, range(frames)), depth=1):
            yield light
            steps.done()

    # Write the clip, the whale, the truth, and last the scene that names them
    with made_folder(folder / TRUTH_FOLDER):
        with one_blas_thread():
            record(made.plate, images(), frame_rate, settings.seed, settings.transfer, settings.bits)
        fine = width >= _FINE
        write_whale(made.mesh, _CALF_M, detail="high" if fine else "low", swims=fine)
        if settings.moves:
            write_whole(folder / TRACK, _track(settings, times))
        write_whole(made.truth, json.dumps(dive_truth(dive, times), indent=1, default=np.ndarray.tolist) + "\n")
        write_whole(made.scene, scene_text(dive_scene(dive)))
    return made


@checked
def check_recording(width: int, frames: int, samples: int) -> None:
    """Raise `ParameterError` with a line for each wrong number."""
    wrong = []
    if width < 64 or width % 4:
        wrong.append(f"width - must be a multiple of 4 from 64 up (got {width}) - take 1024 or 2048")
    if frames < 1:
        wrong.append(f"frames - must be at least 1 (got {frames}) - take 48")
    if not 1 <= samples <= 8:
        wrong.append(f"samples - must be 1 to 8 (got {samples}) - take 1, or 2 for smooth edges")
    if wrong:
        raise ParameterError("\n".join(wrong))
    PICTURE.check("width", width * width // 2, ParameterError)
    FRAMES.check("frames", frames, ParameterError)


def dive_scene(dive: Dive) -> dict[str, object]:
    """Return the keys of the dive's scene that differ from their defaults."""
    # Give the sun as it is, and the sun's share of the light
    settings, sun = dive.settings, dive.sun_in_water
    water: dict[str, Any] = {"type": settings.water, "sensor": SENSOR}
    light: dict[str, Any] = {}
    if sun is None:
        light = {"light": {"sun": "none"}}
    else:
        elevation = round(float(np.degrees(np.arcsin(sun[1]))), 3)
        azimuth = round(float(np.degrees(np.arctan2(sun[0], -sun[2]))), 3)
        water |= {"sun_share": round(dive.sun_share, 4), "sun_elevation_deg": elevation}
        light = {"light": {"sun": "given", "sun_azimuth_deg": azimuth, "sun_elevation_deg": elevation}}
    # Name the curve and the camera's track where they are not the usual ones
    plate: dict[str, Any] = {"path": "dive.mp4"}
    if settings.transfer != "srgb":
        plate["transfer"] = settings.transfer
    track: dict[str, object] = {"track": TRACK} if settings.moves else {}
    return {
        "plate": plate,
        "camera": {"depth_m": settings.depth_m} | track,
        "water": water,
        **light,
        "sea": settings.sea.model_dump(exclude_unset=True),
        "object": [
            {"mesh": "whale.glb", "position_m": [0.4, -0.6, -3.6], "face": -60.0, "rotation_deg": [0.0, 4.0, 0.0]}
        ],
        "receiver": {"height_m": settings.depth_m - settings.floor_depth_m},
    }


def _track(settings: DiveSettings, times_s: list[float]) -> str:
    """Return the camera's motion as CSV."""
    from scipy.spatial.transform import Rotation

    rows = ["time_s,x,y,z,qx,qy,qz,qw"]
    for time_s in times_s:
        position, rotation = settings.camera_at(time_s)
        numbers = (time_s, *position, *Rotation.from_matrix(rotation).as_quat())
        rows.append(",".join(repr(float(number)) for number in numbers))
    return "\n".join(rows) + "\n"


# Recording synthetic pictures and a tone as a 360 camera would: H.264, BT.709, AAC, spherical metadata.
#
# The sensor's noise is that of counted photons and of reading them out, on linear light before its curve.

_FULL_WELL = 6000.0
"""Electrons of a pixel that is white, of a small camera in good light. Half as many: noise is 1.4 times as strong."""
_READ = 3.0
"""Standard deviation of reading a pixel out, in electrons."""


def with_noise(image: Floats, strength: float, seed: int, index: int) -> Floats:
    """Return a linear image (H, W, 3) as a sensor counts it; `strength` is a factor on the variance.

    The variance of a value v is (v/N + (r/N)^2) strength: N electrons are white, r those of reading out. Normal
    deviates stand for counts. Seed and index decide them.
    """
    if strength <= 0.0:
        return image
    rng = np.random.default_rng((seed, index, 0x4E01))
    variance = strength * (np.maximum(image, 0.0) / _FULL_WELL + (_READ / _FULL_WELL) ** 2)
    return np.asarray(image + np.sqrt(variance, dtype=np.float32) * rng.standard_normal(image.shape, np.float32))


_SOUND_RATE_HZ = 48_000
_TONE_HZ = 110.0
_FORMATS = {8: "yuv420p", 10: "yuv420p10le"}


def record(
    path: Path, images: Iterable[Floats], frame_rate: Fraction, seed: int, transfer: Transfer = "srgb",
    bits: Literal[8, 10] = 8,
) -> int:  # fmt: skip
    """Write linear images (H, W, 3) as an MP4 with a tone of the same length; return how many there were.

    Values above 1 clip, as in a camera. transfer, bits: of the codes. The file appears when it is complete.
    """
    from mr360uw.video import SphericalMetadata, write_spherical
    from mr360uw.video.clip import BT709_TAGS
    from mr360uw.video.demux import create_local

    count = 0
    with whole_file(path) as partial:
        with create_local(partial, "mp4") as container:
            sound = container.add_stream("aac", rate=_SOUND_RATE_HZ)
            sound.layout = "mono"
            video = container.add_stream("libx264", rate=frame_rate, options={"crf": "14", "preset": "veryfast"})
            video.pix_fmt = _FORMATS[bits]
            BT709_TAGS.write_to(video.codec_context)
            for image in images:
                if count == 0:
                    video.height, video.width = image.shape[:2]
                container.mux(video.encode(_picture(image, transfer, bits, (seed, count))))
                count += 1
            container.mux(video.encode(None))
            samples = int(_SOUND_RATE_HZ * count / frame_rate)
            for start in range(0, samples, 1024):
                container.mux(sound.encode(_tone(start, min(start + 1024, samples))))
            container.mux(sound.encode(None))
        write_spherical(partial, SphericalMetadata())
    return count


def _picture(image: Floats, transfer: Transfer, bits: Literal[8, 10], seed: tuple[int, int]) -> Any:
    """Return PyAV's frame of planes, 4:2:0, limited range, each with a dither of its own.

    Dither goes onto Y', Cb and Cr, not onto RGB: in deep blue water a step of Cr is a tenth of the red.
    """
    from mr360uw.video.planes import native_frame

    code = encode(np.clip(image, 0.0, 1.0), transfer).astype(np.float32)
    luma, blue, red = np.moveaxis(code @ ycbcr_from_rgb("bt709").T.astype(np.float32), -1, 0)
    rng = np.random.default_rng(seed)
    step, kind = 2 ** (bits - 8), np.uint8 if bits == 8 else np.uint16

    def codes(values: Floats) -> NDArray[Any]:
        dithered = np.floor(step * values + rng.random(values.shape, np.float32))
        return np.clip(dithered, step, 255 * step - 1).astype(kind)

    y, u, v = (codes(plane) for plane in (16.0 + 219.0 * luma, *(128.0 + 224.0 * _halved(c) for c in (blue, red))))
    return native_frame(YuvImage(y, u, v, ColorSpec(bits=bits)))


def _halved(chroma: Floats) -> Floats:
    """Return half the rows and columns of a panorama's chroma, sited left: weights 1, 2, 1 across, 1, 1 down."""
    across = 0.25 * np.roll(chroma, 1, axis=1) + 0.5 * chroma + 0.25 * np.roll(chroma, -1, axis=1)
    return 0.5 * (across[0::2, 0::2] + across[1::2, 0::2])


def _tone(start: int, stop: int) -> object:
    """Return samples [start, stop) of a low tone that swells every two seconds."""
    import av

    t = np.arange(start, stop) / _SOUND_RATE_HZ
    swell = 0.2 * (0.6 + 0.4 * np.sin(np.pi * t))
    wave = (swell * np.sin(2.0 * np.pi * _TONE_HZ * t)).astype(np.float32)
    frame = av.AudioFrame.from_ndarray(wave[None], format="fltp", layout="mono")
    frame.sample_rate, frame.pts, frame.time_base = _SOUND_RATE_HZ, start, Fraction(1, _SOUND_RATE_HZ)
    return frame


# The truth of a synthetic dive: its light, water, waves and camera as JSON, its distances and masks as pictures.

_BANDS_NM = np.arange(400.0, 701.0, 25.0)


def dive_truth(dive: Dive, times_s: list[float]) -> dict[str, Any]:
    """Return the fields of `truth.json`, as docs/sample.md lists them, arrays as they are. Light is relative to that
    just below a level surface, angles are in degrees, vectors are in the world.
    """
    settings, sun = dive.settings, dive.sun
    wet, waves = Water.jerlov(settings.water), settings.sea.waves
    ambient, beam = dive.irradiance(settings.depth_m)
    # List light, water and waves, and at the end what differs from frame to frame
    return {
        "sun_direction_in_air": sun and sun.direction,
        "sun_direction_in_water": dive.sun_in_water,
        "sun_half_angle_rad": sun and sun.half_angle_rad,
        "sun_irradiance_in_air": sun and sun.irradiance,
        "sun_share_of_surface_irradiance": dive.sun_share,
        "irradiance": {
            "just_below_surface": _shares(dive.sky_below, dive.sun_below),
            "camera": _shares(ambient, beam * dive.water.sun_up),
            "floor": dive.floor_irradiance,
        },
        "camera_depth_m": settings.depth_m,
        "camera_speed_m_s": settings.speed_m_s,
        "floor_depth_m": settings.floor_depth_m,
        "floor_tile_m": BED_TILE_M,
        "floor_mean_albedo": dive.scene.floor.mean_albedo,
        "level_radiance_linear": dive.level_radiance,
        "exposure": dive.exposure,
        "sensor": SENSOR,
        "water": settings.water,
        "water_properties": {
            "wavelength_nm": _BANDS_NM,
            "absorption_per_m": wet.absorption(_BANDS_NM),
            "scattering_per_m": wet.scattering(_BANDS_NM),
        },
        "sea": settings.sea.model_dump(mode="json"),
        "waves": {
            "wave_vector_rad_per_m": waves.wave_vector,
            "amplitude_m": waves.amplitude_m,
            "steepness": waves.steepness,
            "phase_rad": waves.phase_rad,
            "angular_frequency_rad_per_s": waves.angular_frequency,
        },
        "settings": settings.model_dump(mode="json"),
        "frames": [_frame(dive, k, time_s) for k, time_s in enumerate(times_s)],
    }


def write_frame_truth(path: Path, dive: Dive, seen: SurfacePicture) -> None:
    """Write distances, masks and normals of a frame's pixel centres as arrays of an .npz file.

    distance_m: (H, W) to surface or floor. in_water_m: (H, W). surface, floor: (H, W) masks. normal: (H, W, 3) of the
    surface. radiance: (H, W, 3), exposed, not clipped, float16.
    """
    with whole_file(path) as partial, partial.open("wb") as file:
        np.savez_compressed(
            file, distance_m=seen.distance_m.astype(np.float32), in_water_m=seen.in_water_m.astype(np.float32),
            surface=seen.surface, floor=seen.floor, normal=seen.normal.astype(np.float16),
            radiance=np.minimum(dive.exposure * seen.radiance, 6e4).astype(np.float16),
        )  # fmt: skip


def _frame(dive: Dive, index: int, time_s: float) -> dict[str, Any]:
    """Return what is known of one frame; the horizon is the direction up, in the camera's axes."""
    (position, rotation), sun = dive.settings.camera_at(time_s), dive.sun_in_water
    return {
        "index": index,
        "time_s": time_s,
        "position_m": position,
        "world_from_camera": rotation,
        "up_in_camera": rotation[1],
        "sun_in_camera": None if sun is None else sun @ rotation,
        "depth_m": dive.settings.depth_m - float(position[1]),
    }


def _shares(sky: Floats, sun: Floats) -> dict[str, Any]:
    return {"sky": sky, "sun": sun, "luminance": float(luminance(sky + sun))}


# --- Its whale: a humpback that swims, stored beside this module, 1 m long, as samples/humpback/make.py makes it -----


def write_whale(
    path: Path, length_m: float = 13.5, *, detail: Literal["high", "low"] = "high", swims: bool = True
) -> None:
    """Write a humpback whale as binary glTF: metres, front +z, up +y, its middle at the origin.

    One closed skin, a skeleton, and a stroke of swimming that repeats.

    Parameters
    ----------
    path : Path
        File to write, .glb.
    length_m : float
        Length from the snout to the notch of the flukes; adults are 11 to 16 m, newborn calves 4 m long.
    detail : str
        "high": 24 thousand triangles, maps of colour, roughness and normals of 2048 x 2048; "low": 2 thousand, matt, a
        map of colour of 256 x 256.
    swims : bool
        Whether it has a skeleton and swims; else it is rigid.
    """
    # A file is a header of 12 bytes and two chunks, of JSON and of arrays; each begins with its size and kind
    stored = resources.files("mr360uw.sample").joinpath(f"humpback_{detail}.glb").read_bytes()
    start = 28 + int.from_bytes(stored[12:16], "little")
    tree, arrays = json.loads(stored[20 : start - 8]), bytearray(stored[start:])
    places = [tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    # Enlarge places in the skin, of joints, and of the joint that moves; each matrix back ends in a place
    clip = tree["animations"][0]
    moved = [way["sampler"] for way in clip["channels"] if way["target"]["path"] == "translation"]
    for number in places + [clip["samplers"][sampler]["output"] for sampler in moved]:
        values, entry = _array(tree, arrays, number, 3), tree["accessors"][number]
        values *= np.float32(length_m)
        entry["min"], entry["max"] = values.min(axis=0).tolist(), values.max(axis=0).tolist()
    _array(tree, arrays, tree["skins"][0]["inverseBindMatrices"], 16)[:, 12:15] *= np.float32(length_m)
    for node in tree["nodes"][1:]:
        node["translation"] = (length_m * np.array(node["translation"])).tolist()
    for named in (tree["asset"], tree["nodes"][0]):
        named["extras"]["length_m"] = length_m
    if not swims:
        del (
            tree["skins"],
            tree["animations"],
            tree["nodes"][1:],
            tree["nodes"][0]["skin"],
            tree["scenes"][0]["nodes"][1:],
        )
        for name in ("JOINTS_0", "WEIGHTS_0"):
            del tree["meshes"][0]["primitives"][0]["attributes"][name]
    # Pack it again (glTF 2.0 specification, section 4.4)
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    body = len(text).to_bytes(4, "little") + b"JSON" + text + stored[start - 8 : start] + arrays
    write_whole(path, stored[:8] + (12 + len(body)).to_bytes(4, "little") + body)


def _array(tree: dict[str, Any], arrays: bytearray, number: int, columns: int) -> NDArray[np.float32]:
    """Return an accessor's rows of 32-bit floats, to be changed in place."""
    entry = tree["accessors"][number]
    offset = tree["bufferViews"][entry["bufferView"]]["byteOffset"]
    return np.frombuffer(arrays, np.float32, columns * entry["count"], offset).reshape(-1, columns)
