# SPDX-License-Identifier: Apache-2.0
"""Makes a first scene: looks at a plate and a mesh, writes the scene and a preview of it, says what was found.

Drafts of the scene are drawn before that: grey cards on its ground tell its exposure, and a body that the water hides
is brought nearer."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mr360uw.base.color import encode, luminance
from mr360uw.base.files import check_outputs, whole_file
from mr360uw.base.input_files import read_json
from mr360uw.base.progress import Progress
from mr360uw.base.sphere import directions, row_solid_angle
from mr360uw.composite.settings import ObjectSettings
from mr360uw.errors import ParameterError, SceneError, VideoError
from mr360uw.first_look.observations import PlateLook, look_at_mesh, look_at_plate
from mr360uw.first_look.place_in_plate import AUTO_TRACK, ShownDistance, Wish, nearer, nearest_m
from mr360uw.first_look.proposal import (
    Proposal,
    brightness_lines,
    corrected,
    found_lines,
    propose,
    scene_lines,
    summary_line,
)
from mr360uw.preview.live import COARSE_WIDTH, LivePreview, coarse
from mr360uw.preview.screen import look, narrowed, perspective, screen_picture
from mr360uw.render.check import possible_outputs
from mr360uw.render.frame import Frame
from mr360uw.render.loaded import Loaded
from mr360uw.render.surroundings import CameraPath
from mr360uw.scene.model import CameraSettings, PlateSettings, Scene, scene_from_dict
from mr360uw.scene.resolved import open_plate
from mr360uw.types import Floats, View

if TYPE_CHECKING:
    from mr360uw.depth.occlusion import PlateDepth

_GREY = 0.18
"""Reflectance of a grey card, and about that of most ground."""
_THIN = 0.01
"""Thickness of a card over its side."""
_WHOLE = 0.95
"""Alpha from which a pixel shows a card alone."""
_FEWEST = 12
"""Pixels of a card below which it tells nothing."""
_DARKEST = 1e-4
"""Light that counts as black."""
_CARDS_DEG = (0.0, 90.0, 180.0, -90.0)
"""Azimuths of the cards. Their median counts: a rock or a diver beside one of them does not."""
_CARD_M, _AWAY = 0.45, 1.2
"""Side of a card, and how far away it lies, over the height of the camera above the ground."""


def _grey_card_stops(live: LivePreview, draft: Scene) -> float | None:
    """Return by how many stops grey cards on a draft's ground are brighter than the plate around them: the median.

    That is how much the light found is too bright, if the ground is as bright as most ground. None where no ground is
    known, or no card is seen.
    """
    import cv2
    import trimesh

    if draft.receiver is None:
        return None
    # Draw the cards, lying on the ground around the camera
    drop = -draft.receiver.height_m
    with TemporaryDirectory() as folder:
        path = Path(folder) / "card.ply"
        trimesh.creation.box((1.0, _THIN, 1.0)).export(path)
        cards = tuple(
            ObjectSettings(
                mesh=path, size_m=_CARD_M * drop, azimuth_deg=azimuth, distance_m=_AWAY * drop, stand_on="receiver",
                face="camera", casts_shadow=False, base_color=(_GREY, _GREY, _GREY), metallic=0.0, roughness=1.0,
            )
            for azimuth in _CARDS_DEG
        )  # fmt: skip
        frame = live.frame(draft.model_copy(update={"objects": cards}), 0, COARSE_WIDTH)
    # Compare each card with what is around it in the plate
    inside = frame.layer.alpha > _WHOLE
    count, labels = cv2.connectedComponents(inside.astype(np.uint8))
    seen, plate = (luminance(picture.image_linear) for picture in (frame.picture, frame.plate))
    found = []
    for number in range(1, count):
        card = labels == number
        if int(card.sum()) >= _FEWEST:
            shown, around = float(np.mean(seen[card])), float(np.median(plate[_rim(card)]))
            found.append(np.log2(max(shown, _DARKEST) / max(around, _DARKEST)))
    return float(np.median(found)) if found else None


def _rim(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels around some (h, w) of a panorama, about as far out as those reach."""
    import cv2

    reach = max(3, round(np.sqrt(int(inside.sum())) / 2))
    wide = np.pad(inside.astype(np.uint8), ((0, 0), (reach, reach)), mode="wrap")
    outer, inner = (cv2.dilate(wide, np.ones((2 * r + 1, 2 * r + 1), np.uint8)) for r in (reach, 1))
    return np.asarray((outer > inner)[:, reach:-reach])


_GHOST_CODES: dict[bool, float] = {True: 24.0, False: 8.0}
"""Difference [codes] from the plate below which a body is a ghost: of large kinds, which should look it, and others."""
_NEARER = 0.7
"""Fraction of its distance that is tried next."""


def _contrast_codes(live: LivePreview, draft: Scene) -> float:
    """Return by how many 8-bit codes a draft's body differs from the plate behind it, the median of its pixels."""
    frame = live.frame(draft, 0, COARSE_WIDTH)
    inside = frame.layer.alpha > _WHOLE
    if not np.any(inside):
        return np.inf
    body, plate = (
        255.0 * encode(np.clip(picture.image_linear[inside], 0.0, 1.0), "srgb")
        for picture in (frame.picture, frame.plate)
    )
    return float(np.median(np.abs(body - plate).max(axis=-1)))


_PREVIEW_COLUMNS, _DRAWN_COLUMNS = 1024, 2048
"""Widths [pixels] of previews, and of the frames that they show, at most."""
_INSET_DEG, _FOOT_SHARE = 60.0, 0.03
"""Field of view of the insets, and the lowest fraction of a body's pixels, which are its foot."""
_RADIANCE = (".exr", ".hdr")
"""Stills of scene radiance, whose composite is one too."""


def _preview(frame: Frame, *, radiance: bool) -> Floats:
    """Return a frame as a sheet of linear light: the whole sphere, below it views of the body and of its foot.

    radiance: exposed so that its median is as bright as a grey card, as light without an exposure of its own.
    """
    light = frame.picture.image_linear
    if radiance:
        light = light * (_GREY / max(float(np.median(luminance(light))), _DARKEST))
    sphere = narrowed(light, _PREVIEW_COLUMNS)
    # Look at the middle of what the body covers, and at its lowest part
    alpha = frame.layer.alpha
    toward = directions(alpha.shape[1], alpha.shape[0])
    seen, weight = toward[alpha > 0.5], row_solid_angle(alpha.shape[1], alpha.shape[0])[np.nonzero(alpha > 0.5)[0]]
    if not len(seen):
        return sphere
    lowest = seen[:, 1] <= np.quantile(seen[:, 1], _FOOT_SHARE)
    width = sphere.shape[1] // 2
    insets = []
    for one, size in ((seen, weight), (seen[lowest], weight[lowest])):
        x, y, z = size @ one
        yaw, pitch = np.degrees([np.arctan2(x, -z), np.arctan2(y, np.hypot(x, z))]).tolist()
        insets.append(look(light, perspective(yaw, pitch, _INSET_DEG, width, 2 * width // 3)))
    return np.concatenate([sphere, np.concatenate(insets, axis=1)])


def make_first_scene(
    video: Path,
    mesh: Path,
    out: Path | None = None,
    wish: Wish | None = None,
    *,
    overwrite: bool = False,
    outside_files: bool = False,
    backend: str = "auto",
    progress: Progress | None = None,
) -> tuple[Path, list[str], list[str]]:
    """Write a scene that puts `mesh` into `video` where it is seen, and a preview of its first frame beside it.

    Returns the scene, lines on what was found and guessed, and commands that go on from there.

    wish: for its place and size, with what is known of the files. outside_files: the mesh may name files outside of its
    folder. The distances of a stereo still are found by its two eyes, and kept beside the scene in PLATE.depth, as a
    path that is asked for is in PLATE.track.csv; progress: of these. Raises the files' errors, `OutputExistsError`,
    `ParameterError` or `SceneError`; no scene is written then.
    """
    wish = wish or Wish()
    path, preview = _targets(video, mesh, wish.track, out, overwrite=overwrite)
    plate = look_at_plate(video, wish.eye, underwater=wish.underwater)
    seen = look_at_mesh(mesh, up=wish.up, outside_files=outside_files)
    # Take the camera's path, and the floor that it tells
    if wish.track == AUTO_TRACK:
        wish = replace(wish, track=_path_of_camera(video, path.with_name(f"{video.stem}.track.csv"), plate, progress))
    floor = None if wish.track is None else _floor_of(wish.track)
    # Take both eyes where they agree, and the distances that those of a still tell
    if not plate.eyes_agree:
        wish = replace(wish, eye=plate.eye)
    elif wish.eye is None and wish.depth is None and plate.still:
        folder = path.with_name(f"{video.stem}.depth")
        wish = replace(wish, depth=_distances_of_eyes(video, folder, plate.size[0], progress))
    shown_m = None
    if wish.depth is not None:
        from mr360uw.depth.occlusion import PlateDepth  # whose kernels most plates have no use for

        maps = PlateDepth(wish.depth, right=plate.eye == "right")
        wish = wish if maps.of_both_eyes else replace(wish, eye=plate.eye)
        below_m, shown_m = _shown_by(maps, plate, wish.track)
        floor = floor if below_m is None else (below_m, "by the distances of the plate")

    def text_of(chosen: Proposal) -> str:
        return scene_lines(chosen, path.parent, outside_files=outside_files)

    def scene_of(chosen: Proposal) -> Scene:
        return scene_from_dict(tomllib.loads(text_of(chosen)), path.parent)

    # Propose a scene, try it out, and draw its preview
    width, radiance = min(_DRAWN_COLUMNS, plate.size[0]), plate.path.suffix.lower() in _RADIANCE
    with LivePreview(backend) as live:
        chosen = _tried_out(propose(plate, seen, wish, floor, shown_m), scene_of, live)
        scene = scene_of(chosen)
        loaded = live.loaded(coarse(scene), width)
        sun, to_uncomment = _sun(loaded, live)
        sheet = _preview(live.frame(coarse(scene), 0, width), radiance=radiance)
    with whole_file(preview) as shown, whole_file(path) as file:  # on a full disk neither is there
        shown.write_bytes(screen_picture(sheet, ".png"))
        file.write_text(text_of(chosen) + to_uncomment, "utf-8")
    suffix = (".exr" if radiance else ".png") if plate.still else ".mp4"
    lines = [
        summary_line(chosen, sun, in_doubt=bool(to_uncomment)),
        *found_lines(chosen, sun),
        *brightness_lines(chosen),
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


def _tried_out(chosen: Proposal, scene_of: Callable[[Proposal], Scene], live: LivePreview) -> Proposal:
    """Return a proposal with the exposure that its ground tells, and nearer where the water hides its body.

    scene_of: makes the scene of a proposal.
    """
    chosen = corrected(chosen, _grey_card_stops(live, coarse(scene_of(chosen))))
    place, mesh = chosen.place, chosen.mesh
    if chosen.water is None or place.stands or place.on_shown:
        return chosen
    nearest, least = nearest_m(mesh, place.size_m), _GHOST_CODES[mesh.large]
    while place.distance_m > 1.01 * nearest and _contrast_codes(live, coarse(scene_of(chosen))) < least:
        place = nearer(place, max(_NEARER * place.distance_m, nearest), mesh, chosen.wish)
        chosen = replace(chosen, place=place)
    return chosen


def _targets(video: Path, mesh: Path, track: Path | None, out: Path | None, *, overwrite: bool) -> tuple[Path, Path]:
    """Return the names of the scene and of its preview; raise where they cannot be written."""
    if not video.name:
        raise VideoError(f"{video} - is a folder - name a video or a picture")
    path = out if out is not None else video.with_suffix(".toml")
    if path.suffix.lower() != ".toml":
        raise SceneError(str(path), [f"is no name of a scene file (got {path.suffix!r}) - end it in .toml"])
    preview = path.with_suffix(".preview.png")
    given = [] if track in (None, AUTO_TRACK) else [track]
    check_outputs([path, preview], inputs=[video, mesh, *given], overwrite=overwrite)
    for name in (str(video), str(mesh)):
        if any("\ud800" <= c <= "\udfff" for c in name):
            raise SceneError(str(path), [f"cannot name a file whose name is no UTF-8 (got {name!r}) - rename the file"])
    return path, preview


def _path_of_camera(video: Path, out: Path, plate: PlateLook, progress: Progress | None) -> Path:
    """Write the path of a clip's camera, unless it is there; return its file."""
    from mr360uw.track.tracking import track_camera  # which few plates have a use for

    if not out.is_file():
        track_camera(video, eye=plate.eye, progress=progress).save(out)
    return out


def _distances_of_eyes(video: Path, folder: Path, columns: int, progress: Progress | None) -> Path | None:
    """Write the distances of both eyes of a stereo still into a folder, unless they are there; return the folder.

    columns: of an eye. None where they are too few to tell distances.
    """
    from mr360uw.depth.clip_depth import LEAST_WIDTH
    from mr360uw.depth.clip_eyes import depth_of_eyes  # whose kernels most plates have no use for

    if columns < LEAST_WIDTH:
        return None
    depth_of_eyes(video, folder, progress=progress)
    return folder


def _shown_by(maps: PlateDepth, plate: PlateLook, track: Path | None) -> tuple[float | None, ShownDistance]:
    """Return how far [m] maps of a plate's distances show the ground below the camera, None where they do not, and
    what tells other distances. The camera is levelled by its track, or by the tilt that the plate shows.
    """
    camera = CameraSettings(track=track, roll_deg=plate.roll_deg, pitch_deg=plate.pitch_deg)
    position, rotation = CameraPath.of(Scene(plate=PlateSettings(path=plate.path), camera=camera)).at(0.0)

    def shown_m(directions: Floats) -> Floats:
        return maps.toward(0, directions @ rotation)

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
