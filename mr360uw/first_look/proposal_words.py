# SPDX-License-Identifier: Apache-2.0
"""Says in words what was found and guessed, and writes it as a scene of some thirty lines."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from mr360uw.color import encode
from mr360uw.constants import DEPTH_EYES_S, DEPTH_FRAME_S
from mr360uw.first_look.mesh_look import MeshLook
from mr360uw.first_look.place_in_plate import UNEVEN, Place
from mr360uw.first_look.plate_look import SURE, PlateLook, WaterOrAir
from mr360uw.first_look.proposal import Proposal, Sight
from mr360uw.medium.waterfit import CONFIDENT
from mr360uw.scene.toml_model import toml_value
from mr360uw.video.formats import FISHEYE_FOV_DEG

_WIDTH = 34
"""Column at which comments of a scene start."""


def found_lines(plate: PlateLook, mesh: MeshLook, chosen: Proposal, sun: str) -> list[str]:
    """Return a line for each thing found in the files or guessed. sun: that of the plate, in words."""
    width, height = plate.size
    kind = "a still" if plate.still else "a clip"
    lines = [f"plate     {plate.path.name}: {kind}, {width}x{height}"]
    if plate.eye is not None:
        lines[0] += f", its {plate.eye} eye"
    if plate.projection != "auto":
        lines[0] += f", from {plate.projection}: it shows that"
    if plate.projection == "dual_fisheye":
        lines.append(f"lenses    {FISHEYE_FOV_DEG:g} degrees each, guessed: plate.fisheye_fov_deg sets it")
    lines.append(where_line(plate.medium))
    if not plate.medium.said and plate.medium.confidence < SURE:
        lines.append(
            "unsure    white balance, dusk and lamps hide which: say it by --water or --air, or set water.type"
        )
    if plate.medium.half:
        lines.append(
            "half      half under and half over water: taken as under water, the camera at its surface; no body is "
            "drawn above"
        )
    lines.append(f"light     {'dark' if plate.dark else 'day'}; {sun}")
    if plate.tilt is not None:
        tilt = plate.tilt
        lines.append(f"level     tilted, by {tilt.by}: roll {tilt.roll_deg:.0f}, pitch {tilt.pitch_deg:.0f} degrees")
    if chosen.water is not None:
        lines += _water_lines(chosen)
    lines += [_floor_line(chosen), *_depth_lines(plate, chosen)]
    named = f"a {mesh.kind.word} by its name" if mesh.kind else "unknown by its name"
    lines.append(
        f"mesh      {mesh.path.name}: {named}; {mesh.why_size}: {mesh.size_m:g} m; front {mesh.front}, {mesh.why_front}"
    )
    if mesh.up != "auto":
        other = "y" if mesh.up == "z" else "z"
        lines.append(f"up        {mesh.up}, {mesh.why_up}; --up {other} if it lies on its side")
    return lines + _place_lines(chosen.place)


def where_line(medium: WaterOrAir) -> str:
    """Return whether a plate is under water or in air, and how that is told."""
    where, so = ("under water", "") if medium.underwater else ("in air", "; nothing is done about water")
    red = f"red is {medium.red_far:.2f} of green or blue in the distance"
    if medium.said:
        other = f", though it looks {'in air' if medium.underwater else 'under water'}"
        but = f"{other} (confidence {medium.confidence:.2f})" if medium.contradicted else ""
        return f"where     {where}, as you say{but}: {red}{so}"
    guess = "" if medium.confidence >= SURE else "a guess: "
    return f"where     {guess}{where}: {red}{so} (confidence {medium.confidence:.2f})"


def _floor_line(chosen: Proposal) -> str:
    """Return what is known of the ground."""
    place = chosen.place
    if place.drop_m is None or place.hangs:
        return "floor     none seen below, so no shadow on it (receiver)"
    how = chosen.floor_by or "guessed: nothing shows it"
    return f"floor     (receiver) {place.drop_m:.3g} m below the camera, {how}"


def _depth_lines(plate: PlateLook, chosen: Proposal) -> list[str]:
    """Return what could tell how far away everything is, where that is not given."""
    if chosen.depth is not None or (chosen.track is None and plate.eyes is None):
        return []
    how = f"--track {chosen.track}" if plate.eyes is None else "--eye both"
    frame_s = DEPTH_FRAME_S if plate.eyes is None else DEPTH_EYES_S
    return [
        f"behind    no body goes behind what is nearer: mr360uw depth {plate.path.name} -o depth {how} finds how far "
        f"away everything is, in about {frame_s:g} s a frame; then --depth depth"
    ]


def _place_lines(place: Place) -> list[str]:
    """Return where the object is, and what is doubtful there."""
    lines = []
    if place.smaller:
        lines.append(
            f"size      made {place.size_m:g} m long, because this water hides what is farther away; size_m sets it"
        )
    how = (
        "its foot on what the plate shows there"
        if place.on_shown
        else f"off the floor, {place.elevation_deg:g} degrees over the horizon"
    )
    how = "stands on the floor" if place.stands else how
    ahead = "seen from the side" if place.face != "camera" else "facing the camera"
    lines.append(f"place     {_side(place.azimuth_deg)}, {place.distance_m:g} m away, {how}, {ahead}")
    if place.hangs:
        lines.append(
            "ground    none is seen that it could stand on, so it hangs in the water; --stand puts it on a floor"
        )
    elif place.uneven > UNEVEN:
        lines.append("ground    nowhere even: look at its foot; --at AZIMUTH,ELEVATION puts that elsewhere")
    return lines


def _water_lines(chosen: Proposal) -> list[str]:
    water = chosen.water
    assert water is not None
    code = np.round(255.0 * encode(np.clip(np.array(water.color), 0.0, 1.0), "srgb")).astype(int)
    hex_code = "".join(f"{c:02x}" for c in code.tolist())
    veil = f"open water has the colour #{hex_code} (veil)"
    if water.confidence <= 0.0:
        told = f"type {water.type} assumed: no Jerlov type has that colour"
    elif water.confidence >= CONFIDENT:
        told = f"type {water.type}, confidence {water.confidence:.2f}"
    else:
        others = f"; {', '.join(water.others)} are nearly as likely" if water.others else ""
        told = f"type {water.type} is nearest, confidence only {water.confidence:.2f}{others}"
    shade = f"; near blacks have less haze (shade {water.sight.shade:.2g})" if water.sight.shade else ""
    return [
        f"water     {told}; {veil}",
        f"sight     (visibility) {water.sight.visibility_m:.2g} m, {_sight_words(water.sight)}{shade}",
        f"depth     {chosen.depth_m:g} m guessed: one picture does not show it",
    ]


def brightness_lines(stops: float | None) -> list[str]:
    """Return a line where a grey card at the object's place is brighter or darker than the plate around by a stop."""
    if stops is None or abs(stops) < 1.0:
        return []
    way = "darker" if stops < 0.0 else "brighter"
    return [
        f"grey      a grey card would be {abs(stops):.1f} stops {way} there than what is around it: "
        f"light.exposure = {-stops:.1f} makes up for that"
    ]


def _sight_words(sight: Sight) -> str:
    """Return how well a visibility is known."""
    told = f"by the {sight.by}" if sight.by else "a guess, nothing shows it"
    return f"{told}; {sight.low_m:.2g} to {sight.high_m:.2g} m are as likely"


def _side(azimuth_deg: float) -> str:
    if abs(azimuth_deg) < 1.0:
        return "straight ahead"
    return f"{abs(azimuth_deg):g} degrees to the {'right' if azimuth_deg > 0.0 else 'left'}"


def scene_lines(plate: PlateLook, mesh: MeshLook, chosen: Proposal, folder: Path, *, outside_files: bool) -> str:
    """Return the text of the scene, for a file in a folder."""
    rows: list[tuple[str, str]] = [
        ("[plate]", ""),
        (f"path = {toml_value(relative_to(plate.path, folder))}", ""),
    ]
    if plate.eye is not None:
        rows.append((f'eye = "{plate.eye}"', "of the two"))
    if plate.projection != "auto":
        rows.append((f'projection = "{plate.projection}"', "by what its first picture shows"))
    if chosen.depth is not None:
        note = "distances: bodies go behind what is nearer, shadows fall on it"
        rows.append((f"depth = {toml_value(relative_to(chosen.depth, folder))}", note))
    rows += [("", ""), *_camera_rows(plate, chosen, folder), ("", ""), *_water_rows(chosen), ("", "")]
    rows += _object_rows(mesh, chosen, folder, outside_files=outside_files)
    if chosen.place.drop_m is not None and not chosen.place.hangs:
        known = chosen.floor_by or "a guess: height of the floor over the camera"
        rows += [
            ("", ""),
            ("[receiver]", "the floor, on which shadows fall"),
            (f"height_m = {-chosen.place.drop_m:.3g}", known),
        ]
    if chosen.lamp:
        rows += [("", ""), ("[[lamp]]", "the plate is dark"), ('attach = "camera"', ""), ("lumen = 3000.0", "")]
    head = [
        "# A scene of mr360uw, from a first look at its plate and mesh. What was guessed says so.",
        "# All keys: mr360uw schema --markdown",
        "",
    ]
    body = [f"{text:<{_WIDTH}} # {note}" if note else text for text, note in rows]
    return "\n".join([*head, *body, ""])


def _camera_rows(plate: PlateLook, chosen: Proposal, folder: Path) -> list[tuple[str, str]]:
    note = (
        "a guess: how deep the camera was; sets light and colour"
        if chosen.water is not None
        else "without water: no matter"
    )
    rows = [("[camera]", ""), (f"depth_m = {chosen.depth_m:g}", note)]
    if chosen.track is not None:
        rows.append((f"track = {toml_value(relative_to(chosen.track, folder))}", ""))
    elif plate.tilt is not None:
        tilt = plate.tilt
        rows += [(f"roll_deg = {tilt.roll_deg:.1f}", f"by {tilt.by}"), (f"pitch_deg = {tilt.pitch_deg:.1f}", "")]
    return rows


def _water_rows(chosen: Proposal) -> list[tuple[str, str]]:
    if chosen.water is None:
        return [("[water]", ""), ('type = "none"', "the plate is in air")]
    water = chosen.water
    sure = f"confidence {water.confidence:.2f}" if water.confidence > 0.0 else "a guess"
    rows = [
        ("[water]", ""),
        (f'type = "{water.type}"', f"Jerlov: I IA IB II III, 1C 3C 5C 7C 9C; {sure}"),
        (f"visibility_m = {water.sight.visibility_m:.2g}", f"how far one sees; {_sight_words(water.sight)}"),
    ]
    if water.sight.shade > 0.0:
        rows.append(
            (f"shade = {water.sight.shade:.2g}", "of the haze (veil) that is not before near things: their blacks")
        )
    return rows


def _object_rows(mesh: MeshLook, chosen: Proposal, folder: Path, *, outside_files: bool) -> list[tuple[str, str]]:
    place = chosen.place
    rows = [
        ("[[object]]", ""),
        (f"mesh = {toml_value(relative_to(mesh.path, folder))}", ""),
        (
            f"size_m = {place.size_m:g}",
            f"longest side; {mesh.why_size if place.size_m == mesh.size_m else 'as it is put'}",
        ),
        (f"azimuth_deg = {place.azimuth_deg:g}", "to the right of straight ahead"),
    ]
    if place.stands:
        rows.append(('stand_on = "receiver"', "on the floor"))
    else:
        foot = "of its middle, whose foot is on what the plate shows" if place.on_shown else "over the horizon"
        rows.append((f"elevation_deg = {place.elevation_deg:g}", foot))
    face = '"camera"' if isinstance(place.face, str) else f"{place.face:g}"
    rows += [
        (f"distance_m = {place.distance_m:g}", "from the camera"),
        *([(f'up = "{mesh.up}"', f"axis of the mesh that is up: {mesh.why_up}")] if mesh.up != "auto" else []),
        (f'front = "{mesh.front}"', f"of the mesh: {mesh.why_front}"),
        (f"face = {face}", 'azimuth its front points to, or "camera"'),
    ]
    if len(mesh.clips) > 1:
        rows.append((f"animation = {toml_value(mesh.clips[0])}", f"the first of {len(mesh.clips)}"))
    return [*rows, ("outside_files = true", "")] if outside_files else rows


def relative_to(file: Path, folder: Path) -> str:
    """Return `file` as seen from `folder`, with forward slashes; absolute where they share no root."""
    try:
        return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return file.resolve().as_posix()
