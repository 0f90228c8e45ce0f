# SPDX-License-Identifier: Apache-2.0
"""Opens the plate of a scene."""

from __future__ import annotations

from mr360uw.color import PlateMapping
from mr360uw.errors import VideoError
from mr360uw.reading.input_files import read_data
from mr360uw.reading.numbered_files import files_named
from mr360uw.scene.model import PlateSettings, Scene
from mr360uw.video import VideoReader, open_video
from mr360uw.video.formats import PICTURE_SUFFIXES, projection_of
from mr360uw.video.layout import EyesSeen, eyes_seen
from mr360uw.video.picture_shape import Shape, shape_of_codes, way_out
from mr360uw.video.picture_tags import read_tags
from mr360uw.video.reader import scaled
from mr360uw.yuv.cube_lut import CubeLut, clipped_greys
from mr360uw.yuv.ocio_transform import ocio_mapping


def open_plate(scene: Scene) -> VideoReader:
    """Return the scene's plate, opened as its table says; raise `VideoError`."""
    plate = scene.plate
    video = open_video(
        plate.path, transfer=plate.transfer, primaries=plate.primaries, eye=plate.eye, frame_rate=plate.frame_rate,
        damaged=plate.damaged, projection=plate.projection, fisheye_fov_deg=plate.fisheye_fov_deg, layout=plate.layout,
        decoder=plate.decoder,
    )  # fmt: skip
    mapping = _mapping(plate)
    if mapping is not None:
        video.spec = video.spec.mapped(mapping)
        video.notes += _clipping(plate, mapping)
    return scaled(video, plate.scale)


def pose_of_plate(plate: PlateSettings) -> tuple[float, float, float]:
    """Return yaw, pitch and roll [deg] that a plate's file states for its panorama; zeros without."""
    file = next(files_named(plate.path), plate.path)
    if projection_of(plate.path, plate.projection) != "equirectangular" or not file.is_file():
        return 0.0, 0.0, 0.0
    suffix = file.suffix.lower()
    if suffix in PICTURE_SUFFIXES:
        return read_tags(read_data(file, VideoError), suffix, (1, 1))[0].pose_deg
    from mr360uw.video.container import stated_pose

    return stated_pose(file)


def _clipping(plate: PlateSettings, mapping: PlateMapping) -> tuple[str, ...]:
    """Return a note where the table of a plate shows many values as one light."""
    found = clipped_greys(mapping) if isinstance(mapping, CubeLut) else ""
    return (f"{plate.lut} - clips greys {found}: what is drawn as bright or as dark gets the nearest value",) * bool(
        found
    )


def _mapping(plate: PlateSettings) -> PlateMapping | None:
    """Return the table or the colour spaces that a plate is read through, None where it has a curve."""
    if plate.lut is not None:
        from mr360uw.yuv.cube_file import read_cube

        return read_cube(plate.lut, plate.lut_to, plate.levels)
    return None if plate.ocio is None else ocio_mapping(plate.ocio, plate.levels)


def projection_notes(scene: Scene, video: VideoReader, index: int = 0) -> tuple[str, ...]:
    """Return a note where a frame of a scene's plate does not look like a panorama.

    None where the projection is set, to "equirectangular" too.
    """
    if scene.plate.projection != "auto" or projection_of(scene.plate.path, "auto") != "equirectangular":
        return ()
    found = way_out(shape_of_frame(video, index), video.path)
    leave = 'if that is wrong, set plate.projection = "equirectangular"'
    return (f"{video.path} - {found}; {leave}",) if found else ()


def eyes_of_plate(scene: Scene) -> tuple[EyesSeen | None, str]:
    """Return what the two eyes of a scene's plate show in its first frame, None of mono; and a doubt, or ""."""
    if scene.plate.eye is None:
        return None, ""
    with open_plate(scene.model_copy(update={"plate": scene.plate.model_copy(update={"eye": "both"})})) as video:
        frame = next(iter(video.frames(0, 1)))
        assert frame.right is not None
        seen = eyes_seen(frame.image_linear, frame.right.image_linear)
        tagged = video.spherical.stereo if video.spherical is not None else "mono"
        doubt = seen.doubt(scene.plate.layout or (video.stereo if tagged == "mono" else tagged))
    return seen, f"{scene.plate.path} - {doubt}" if doubt else ""


def shape_of_frame(video: VideoReader, index: int = 0) -> Shape:
    """Return what a frame of a plate looks like."""
    frame = next(iter(video.frames(index, index + 1)))
    codes = frame.yuv if frame.yuv is not None else frame.rgb
    return "panorama" if codes is None else shape_of_codes(codes, frame.spec.bits)
