# SPDX-License-Identifier: Apache-2.0
"""Makes a first scene: looks at a plate and a mesh, writes the scene and a preview of it, says what was found.

The preview also compares a grey card at the object's place with what is around it in the plate."""

from __future__ import annotations

import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import luminance
from mr360uw.base.files import check_outputs, whole_file
from mr360uw.base.input_files import read_json
from mr360uw.composite.settings import ObjectSettings
from mr360uw.errors import ParameterError, SceneError, VideoError
from mr360uw.first_look.observations import PlateLook, look_at_mesh, look_at_plate
from mr360uw.first_look.place_in_plate import ShownDistance, Wish
from mr360uw.first_look.proposal import brightness_lines, found_lines, propose, scene_lines
from mr360uw.preview.live import COARSE_WIDTH, LivePreview, coarse, screen_picture
from mr360uw.render.check import possible_outputs
from mr360uw.render.loaded import Loaded
from mr360uw.render.surroundings import CameraPath
from mr360uw.scene.model import CameraSettings, PlateSettings, Scene, scene_from_dict
from mr360uw.scene.resolved import open_plate
from mr360uw.types import Floats, View

_GREY = 0.18
"""Reflectance of a grey card, and about that of most ground."""
_THIN = 0.01
"""Thickness of the card over its side."""
_WHOLE = 0.95
"""Alpha from which a pixel shows the card alone."""
_FEWEST = 12
"""Pixels of the card below which nothing is told."""
_DARKEST = 1e-4
"""Light that counts as black."""


def _grey_card_stops(live: LivePreview, draft: Scene) -> float | None:
    """Return by how many stops a grey card in the place of a draft's object is brighter than the plate around it.

    Where the object stands the card lies on the ground, else it faces the camera. None where it is not seen.
    """
    import trimesh

    body = draft.objects[0]
    lies = body.stand_on is not None
    with TemporaryDirectory() as folder:
        path = Path(folder) / "card.ply"
        trimesh.creation.box((1.0, _THIN, 1.0) if lies else (1.0, 1.0, _THIN)).export(path)
        card = ObjectSettings(
            mesh=path, size_m=body.size_m, azimuth_deg=body.azimuth_deg, elevation_deg=body.elevation_deg,
            distance_m=body.distance_m, stand_on=body.stand_on, face="camera", casts_shadow=False,
            base_color=(_GREY, _GREY, _GREY), metallic=0.0, roughness=1.0,
        )  # fmt: skip
        frame = live.frame(draft.model_copy(update={"objects": (card,)}), 0, COARSE_WIDTH)
    inside = frame.layer.alpha > _WHOLE
    if int(inside.sum()) < _FEWEST:
        return None
    seen, plate = (luminance(picture.image_linear) for picture in (frame.picture, frame.plate))
    shown, around = float(np.mean(seen[inside])), float(np.median(plate[_rim(inside)]))
    return float(np.log2(max(shown, _DARKEST) / max(around, _DARKEST)))


def _rim(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels around some (h, w) of a panorama, about as far out as those reach."""
    import cv2

    reach = max(3, round(np.sqrt(int(inside.sum())) / 2))
    wide = np.pad(inside.astype(np.uint8), ((0, 0), (reach, reach)), mode="wrap")
    outer, inner = (cv2.dilate(wide, np.ones((2 * r + 1, 2 * r + 1), np.uint8)) for r in (reach, 1))
    return np.asarray((outer > inner)[:, reach:-reach])


_PREVIEW_COLUMNS = 1024
"""Width [pixels] of previews, at most."""
_RADIANCE = (".exr", ".hdr")
"""Stills of scene radiance, whose composite is one too."""


def make_first_scene(
    video: Path,
    mesh: Path,
    out: Path | None = None,
    wish: Wish | None = None,
    *,
    overwrite: bool = False,
    outside_files: bool = False,
    backend: str = "auto",
) -> tuple[Path, list[str], list[str]]:
    """Write a scene that puts `mesh` into `video` where it is seen, and a preview of its first frame beside it.

    Returns the scene, lines on what was found and guessed, and commands that go on from there.

    wish: for its place and size, with what is known of the files. outside_files: the mesh may name files outside of its
    folder. Raises the files' errors, `OutputExistsError`, `ParameterError` or `SceneError`; nothing is written then.
    """
    wish = wish or Wish()
    path, preview = _targets(video, mesh, wish.track, out, overwrite=overwrite)
    plate = look_at_plate(video, wish.eye, underwater=wish.underwater)
    seen = look_at_mesh(mesh, up=wish.up, outside_files=outside_files)
    floor = None if wish.track is None else _floor_of(wish.track)
    shown_m = None
    if wish.depth is not None:
        below_m, shown_m = _shown_by(wish.depth, plate, wish.track)
        floor = floor if below_m is None else (below_m, "by the distances of the plate")
    chosen = propose(plate, seen, wish, floor, shown_m)
    text = scene_lines(plate, seen, chosen, path.parent, outside_files=outside_files)
    scene = scene_from_dict(tomllib.loads(text), path.parent)
    with LivePreview(backend) as live:
        draft, width = coarse(scene), min(_PREVIEW_COLUMNS, plate.size[0])
        loaded = live.loaded(draft, width)
        sun, to_uncomment = _sun(loaded, live)
        picture = live.frame(draft, 0, width).picture
        stops = _grey_card_stops(live, draft)
    with whole_file(preview) as shown, whole_file(path) as written:  # on a full disk neither is there
        shown.write_bytes(screen_picture(picture.image_linear, ".png"))
        written.write_text(text + to_uncomment, "utf-8")
    suffix = (".exr" if plate.path.suffix.lower() in _RADIANCE else ".png") if plate.still else ".mp4"
    lines = [
        *found_lines(plate, seen, chosen, sun),
        *brightness_lines(stops),
        *(f"note      {note}" for note in (*_of_file(scene, path), *plate.notes, *loaded.notes)),
    ]
    lines += [f"wrote     {path}", f"          {preview}: look at it first"]
    view = f"{chosen.place.azimuth_deg:g},{chosen.place.elevation_deg:g},75"
    commands = [
        f"next:     mr360uw composite {path} {path.with_suffix(f'.composite{suffix}').name}",
        f"or:       mr360uw still {path} look.png --view {view}",
        f"          mr360uw tune {path}",
    ]
    return path, lines, commands


def _targets(video: Path, mesh: Path, track: Path | None, out: Path | None, *, overwrite: bool) -> tuple[Path, Path]:
    """Return the names of the scene and of its preview; raise where they cannot be written."""
    if not video.name:
        raise VideoError(f"{video} - is a folder - name a video or a picture")
    path = out if out is not None else video.with_suffix(".toml")
    if path.suffix.lower() != ".toml":
        raise SceneError(str(path), [f"is no name of a scene file (got {path.suffix!r}) - end it in .toml"])
    preview = path.with_suffix(".preview.png")
    check_outputs([path, preview], inputs=[video, mesh, *filter(None, [track])], overwrite=overwrite)
    for name in (str(video), str(mesh)):
        if any("\ud800" <= c <= "\udfff" for c in name):
            raise SceneError(str(path), [f"cannot name a file whose name is no UTF-8 (got {name!r}) - rename the file"])
    return path, preview


def _shown_by(depth: Path, plate: PlateLook, track: Path | None) -> tuple[float | None, ShownDistance]:
    """Return how far [m] maps of a plate's distances show the ground below the camera, None where they do not, and
    what tells other distances. The camera is levelled by its track, or by the tilt that the plate shows.
    """
    from mr360uw.depth.occlusion import PlateDepth  # whose kernels most plates have no use for

    camera = CameraSettings(track=track, roll_deg=plate.roll_deg, pitch_deg=plate.pitch_deg)
    position, rotation = CameraPath.of(Scene(plate=PlateSettings(path=plate.path), camera=camera)).at(0.0)
    maps = PlateDepth(depth, right=plate.eye == "right")

    def shown_m(direction: Floats) -> float:
        return maps.toward(0, rotation.T @ direction)

    return maps.ground_below(0, View(2, 1, position, rotation)), shown_m


def _floor_of(track: Path) -> tuple[float, str] | None:
    """Return the height [m] of a camera over the floor of its track, and what told it; None where it has none."""
    table = track.with_suffix(".json")
    if not track.is_file():
        raise ParameterError(f"{track} - no such file - write one with mr360uw track VIDEO -o track.csv")
    if not table.is_file():
        return None
    told = read_json(table, ParameterError)
    try:
        floor = told["floor"]
        return None if floor is None else (-float(floor["height_m"]), "of the camera's track")
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise ParameterError(f"{table} - is no camera track (got {error!s:.100}) - write it again") from error


def _of_file(scene: Scene, path: Path) -> tuple[str, ...]:
    """Return notes on what the plate's file holds that an output of a scene will lack. path: of the scene."""
    with open_plate(scene) as video:
        try:
            return possible_outputs(scene, video, None, str(path))[1]
        except VideoError:  # no container holds its size, as of a still: pictures do
            return video.notes


def _sun(loaded: Loaded, live: LivePreview) -> tuple[str, str]:
    """Return what is found of a sun in the whole first frame; see `detect.sun_found`."""
    scene = loaded.scene
    frame = live.plates.at(scene.model_copy(update={"plate": scene.plate.model_copy(update={"scale": 1.0})}), 0)
    return loaded.surroundings.light.sun_found(frame.pixels, frame.time_s)
