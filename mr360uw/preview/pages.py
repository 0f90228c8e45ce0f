# SPDX-License-Identifier: Apache-2.0
"""Pages and stills: one frame, variants of a scene side by side, and the report on a plate's light and water."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.color import encode, in_plate_primaries
from mr360uw.base.files import check_outputs, write_whole
from mr360uw.base.input_files import files_read
from mr360uw.base.progress import Progress
from mr360uw.base.sphere import frame_from_direction
from mr360uw.errors import ParameterError, VideoError
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.ibl.sun.track import SunTrack, angles_deg
from mr360uw.ibl.tilt import HorizonEstimate, clip_horizon, roll_pitch
from mr360uw.medium.settings import WaterSettings
from mr360uw.plot import svg_plot
from mr360uw.preview.live import LivePreview
from mr360uw.preview.screen import encoded, look, narrowed
from mr360uw.render.check import sun_lines
from mr360uw.render.first_pass import first_pass
from mr360uw.render.lights import plate_map
from mr360uw.render.surroundings import surroundings_over_time
from mr360uw.scene.model import PlateSettings, Scene, at_scale, files_of, load_scene
from mr360uw.scene.resolved import open_plate
from mr360uw.types import Environment, Floats, Sun, View
from mr360uw.video import VideoFrame
from mr360uw.video.clip import WRITTEN_SUFFIXES
from mr360uw.video.planes import codes_from_linear
from mr360uw.video.reader import whole_frame
from mr360uw.video.writer import picture_codes, write_picture

# One composited frame of a scene, whole or as the view of an ordinary camera into it.

_LATEST_S = 1e6
"""Largest time within a clip [s]: eleven days."""


def still_of(
    live: LivePreview,
    scene: Scene,
    *,
    frame: int | None = None,
    time_s: float | None = None,
    view: View | None = None,
) -> VideoFrame:
    """Return one composited frame of a scene's plate, the left eye's with the right one of two, or a view into it.

    frame: its number, as a sequence's files are numbered; or time_s, for the frame that is shown then. The sun and the
    veil are measured in this frame alone; a composite of the clip takes them from all of it, so that its light may
    differ a little. Raises what `composite_video` raises.
    """
    if frame is not None and time_s is not None:
        raise ParameterError("frame, time_s - say the same thing (got both) - give one of them")
    index = 0 if not frame else live.plates.reader(scene).numbered_range(frame, frame + 1)[0]
    if time_s is not None and not 0.0 <= time_s <= _LATEST_S:
        raise ParameterError(f"time_s - is no time of a clip (got {time_s:g}) - give seconds from its start, 0 or more")
    if time_s is not None:
        index = int(time_s * float(live.plates.reader(scene).frame_rate) + 1e-6)
    picture = live.frame(scene, index).picture
    return picture if view is None else _seen(picture, view)


Still = Callable[[LivePreview, Scene], VideoFrame]
"""`still_of` with its frame or time and its view given."""


def save_still(
    path: Path, scene: Scene, still: Still = still_of, *, backend: str = "auto", overwrite: bool = False
) -> None:
    """Write a still as a picture, whose kind follows the suffix.

    Raises `ParameterError` where the name is no picture's, `OutputExistsError` where it is there, unless `overwrite`,
    and `OutputError`.
    """
    if path.suffix.lower() not in WRITTEN_SUFFIXES:
        raise ParameterError(
            f"{path} - is no name of a picture that is written (got {path.suffix!r}) - end it in .png, .jpg or .exr"
        )
    check_outputs([path], inputs=files_of(scene), overwrite=overwrite)
    with files_read() as read, LivePreview(backend) as live:
        picture = still(live, scene)
    check_outputs([path], inputs=read, overwrite=overwrite)  # textures and the like, which only meshes name
    with open_plate(scene) as plate:
        write_picture(path, whole_frame(picture, plate.stereo))


def _seen(picture: VideoFrame, view: View) -> VideoFrame:
    """Return a view into a frame, in the frame's own codes."""
    light, spec = look(picture.image_linear, view), picture.spec
    values = light if spec.mapping is None else in_plate_primaries(light, spec)
    if spec.bits != 32:
        bits = 8 if spec.bits == 8 else 16
        values = codes_from_linear(values, spec.transfer, f"uint{bits}", picture.index)
        spec = replace(spec, matrix="bt709", bits=bits, primaries=None)
    return replace(picture, yuv=None, native=None, rgb=values, spec=spec, wrap=False, right=None, clipped=())


# Many frames on one sheet.

LARGEST_SHEET = 64
"""Pictures on a sheet, at most."""
_COLUMNS = 4
_CELL_WIDTH = 640
_LABEL_ROWS, _GAP = 26, 4
_SHEET_STYLE = """
body { background: #181818; color: #ebebeb; margin: 1.5em; max-width: none; padding: 0; }
h1 { font-size: 1.3em; } main { display: flex; flex-wrap: wrap; gap: 1em; } figure { margin: 0; flex: 1 1 400px; }
img { width: 100%; } figcaption { padding: .3em 0; font-family: ui-monospace, monospace; color: inherit; }
"""


Variant = tuple[str, NDArray[np.uint8]]
"""A picture of a scene with some keys changed: the changes in words, and codes (h, w, 3)."""


def sweep(
    scene: Path,
    out: Path,
    changes: Sequence[tuple[str, ...]],
    still: Still = still_of,
    *,
    scale: float | None = None,
    backend: str = "auto",
    overwrite: bool = False,
    progress: Progress | None = None,
) -> list[Path]:
    """Render one frame of a scene file with each set of overrides; write a labelled sheet and a page, return the paths.

    out: a PNG or JPEG; the page goes beside it as .html and holds its pictures. changes: overrides of each variant, as
    `load_scene` takes them; all are checked before the first is rendered. still: which frame and view is shown. scale:
    size of the frames over the plate's. Raises what `still_of` raises, `ParameterError` for more than `LARGEST_SHEET`
    variants.
    """
    # Check everything before the first frame is rendered
    if len(changes) > LARGEST_SHEET:
        raise ParameterError(
            f"--set - makes too many pictures (got {len(changes)}) - leave values out until there are {LARGEST_SHEET}"
        )
    if out.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise ParameterError(f"{out} - is no name of a sheet (got {out.suffix!r}) - end it in .png or .jpg")
    page = out.with_suffix(".html")
    scenes = [at_scale(load_scene(scene, overrides), scale) for overrides in changes]
    check_outputs([out, page], inputs=[scene, *files_of(scenes[0])], overwrite=overwrite)
    # Render the variants in one preview: what they share is made once
    found = []
    with files_read() as read, LivePreview(backend) as live:
        for number, (one, overrides) in enumerate(zip(scenes, changes, strict=True), 1):
            picture = still(live, one)
            found.append(
                ("  ".join(overrides) or scene.name, narrowed(picture_codes(picture, deep=False), _CELL_WIDTH))
            )
            if progress is not None:
                progress(number, len(scenes))
    check_outputs([out, page], inputs=read, overwrite=overwrite)
    write_whole(out, encoded(contact_sheet(found), out.suffix))
    figures = "\n".join(_figure(codes, words) for words, codes in found)
    parts = [f"<h1>{html.escape(scene.name)}</h1>", f"<main>\n{figures}\n</main>"]
    write_whole(page, html_page(scene.name, parts, _SHEET_STYLE))
    return [out, page]


def contact_sheet(variants: Sequence[Variant]) -> NDArray[np.uint8]:
    """Return variants in rows of up to four, (h, w, 3) uint8, each with its label below."""
    import cv2

    cell = np.max([codes.shape[:2] for _, codes in variants], axis=0) + np.array([_LABEL_ROWS + _GAP, _GAP])
    columns = min(_COLUMNS, len(variants))
    sheet = np.full((-(-len(variants) // columns) * cell[0] + _GAP, columns * cell[1] + _GAP, 3), 24, np.uint8)
    for number, (words, codes) in enumerate(variants):
        row, column = _GAP + cell[0] * (number // columns), _GAP + cell[1] * (number % columns)
        height, width = codes.shape[:2]
        sheet[row : row + height, column : column + width] = codes
        label = words.encode("ascii", "replace").decode()
        (length, _), _ = cv2.getTextSize(label, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 1)
        size = min(0.55, (width - 2 * _GAP) / max(length, 1))
        place = int(column + _GAP), int(row + height + _LABEL_ROWS - 8)
        cv2.putText(sheet, label, place, cv2.FONT_HERSHEY_SIMPLEX, size, (235, 235, 235), 1, cv2.LINE_AA)
    return sheet


# Report on a plate's light and water (HTML), and the track of its sun (JSON, CSV).

_PICTURES = 6
"""Frames that the report shows, evenly spaced over the clip."""
_PICTURE_WIDTH = 640


def analyse_video(
    source: str | Path,
    out: str | Path | None = None,
    *,
    eye: Literal["left", "right"] | None = None,
    in_air: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
    tell: Callable[[str], None] | None = None,
) -> list[Path]:
    """Write a self-contained page about a plate's light and water, and the track of its sun; return the paths.

    source: a video or still, or a scene file with a plate and its settings. eye: of a stereo plate, where the
    source is no scene file. in_air: whether it is a plate without water, whatever the scene says. out: the page; the
    track goes beside it as .sun.json and .sun.csv. tell: gets the lines on the sun that a composite tells. Raises
    `VideoError`, `SceneError`, `ParameterError` or `OutputExistsError`.
    """
    from mr360uw.ibl.sun.track import save_track

    # Load the scene, or make one of the plate; check all that is to be written
    source = Path(source)
    scene = load_scene(source) if source.suffix == ".toml" else Scene(plate=PlateSettings(path=source, eye=eye))
    if in_air:
        scene = scene.model_copy(update={"water": WaterSettings(type="none")})
    page = _page(source, out)
    tracks = [page.with_suffix(suffix) for suffix in (".sun.json", ".sun.csv")]
    check_outputs([page, *tracks], inputs=[source, *files_of(scene)], overwrite=overwrite)
    # Follow the sun over the clip, and read the light of a few frames
    scene = scene.model_copy(update={"light": scene.light.model_copy(update={"track": None, "sun": "detect"})})
    with open_plate(scene) as video:
        over_time = surroundings_over_time(scene)
        smooth = scene.light.smooth and not video.is_still
        analysis = first_pass(over_time(0.0), video, progress, ["sun"] if smooth else [], keyed=over_time)
        track = analysis.sun if isinstance(analysis.sun, SunTrack) else None
        shown = np.unique(np.linspace(0, (video.frame_count or 1) - 1, _PICTURES).astype(int))
        sections, lights, maps = list[tuple[str, str]](), [], []
        for index in shown:
            frame = next(iter(video.frames(int(index), int(index) + 1)))
            reader = over_time(frame.time_s).light
            if index == 0:
                up = reader.world_from_camera(frame.time_s)[1]
            lights.append(reader.of(frame.pixels, time_s=frame.time_s))
            words, _ = reader.sun_found(frame.pixels, frame.time_s)
            small = narrowed(frame.image_linear, _PICTURE_WIDTH)
            sections.append(frame_section(frame.time_s, small, lights[-1], words))
            if tell is not None and index == 0:
                for line in sun_lines(reader, frame, analysis):
                    tell(line)
            maps.append(plate_map(frame.pixels, reader.world_from_camera(frame.time_s)[1]))
    # Write the page, then the sun's track
    if scene.water.type != "none":
        sections += _sections_of_water(scene, lights, maps, up)
    written = [page]
    write_whole(page, light_report(source.name, track, sections))
    if track is not None:
        for path in tracks:
            save_track(track, path)
        written += tracks
    return written


def _sections_of_water(
    scene: Scene, lights: Sequence[Environment], maps: Sequence[Floats], declared_up: Floats
) -> list[tuple[str, str]]:
    """Return the report's sections on how level a plate is, and on the water that its maps (h, w, 3) show.

    lights: of the frames of the maps. declared_up: (3,) the world's up in the camera's axes, from the scene.
    """
    from mr360uw.ibl.tilt import estimate_horizon
    from mr360uw.medium.spectra import named_sensor
    from mr360uw.medium.waterfit import fit_water

    refraction, depth_m = scene.water.refractive_index, scene.camera.depth_m
    tilts = [estimate_horizon(light.residual, refraction) for light in lights]
    fit = fit_water(np.median(maps, axis=0), depth_m, named_sensor(str(scene.water.sensor)), refraction)
    return [("Level", level_section(tilts, declared_up)), (f"Water, for a camera {depth_m:g} m deep", fit.html())]


def _page(source: Path, out: str | Path | None) -> Path:
    """Return the name of the page; raise `VideoError` or `ParameterError` where there is none."""
    if not source.name:
        raise VideoError(f"{source} - is a folder - name a video, a picture or a scene file")
    page = Path(out) if out is not None else source.with_suffix(".html")
    if page.suffix.lower() != ".html":
        raise ParameterError(f"{page} - is no name of a page (got {page.suffix!r}) - end it in .html")
    return page


# --- The report on the light of a clip ------------------------------------------------------------------------------

# HTML report on the light of a clip: one file with its pictures and plots inside, readable offline.
#
# Plate and expanded map with the sun marked, a ball lit by the irradiance, and over time the sun's direction, strength
# and confidence, measured and smoothed, with the exposure. Other stages add sections of their own.


_STEADY_DEG, _LEVEL_DEG = 3.0, 2.0
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #16202a; max-width: 960px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; border-bottom: 1px solid #d5dde3; }
img, svg { max-width: 100%; display: block; } figure { margin: 1em 0; } figcaption { color: #52606d; }
.row { display: flex; gap: 1em; flex-wrap: wrap; } .row > * { flex: 1 1 260px; }
table { border-collapse: collapse; } td, th { padding: .2em .9em .2em 0; text-align: left; }
"""


def light_report(title: str, track: SunTrack | None, sections: Sequence[tuple[str, str]]) -> str:
    """Return the page as one HTML string. sections: (title, HTML fragment) of frames and more, put in as they are."""
    parts = [f"<h1>{html.escape(title)}</h1>"]
    if track is not None:
        parts += ["<h2>Sun</h2>", _summary(track), *_plots(track)]
    parts += [f"<h2>{html.escape(name)}</h2>\n{fragment}" for name, fragment in sections]
    return html_page(title, parts)


def html_page(title: str, parts: Sequence[str], style: str = "") -> str:
    """Return a self-contained page of HTML fragments. style: more rules of CSS than those that all pages have."""
    body = "\n".join(parts)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{html.escape(title)}</title><style>{_STYLE}{style}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


def level_section(estimates: Sequence[HorizonEstimate], declared_up: Floats) -> str:
    """Return an HTML fragment on the tilt estimated from frames, with the lines of a scene file that declare it.

    declared_up: (3,) the world's up in the camera's axes, from the scene.
    """
    roll, pitch = np.degrees(roll_pitch(declared_up))
    said = f"The scene says roll {roll:z.1f}, pitch {pitch:z.1f} degrees."
    found = clip_horizon(estimates)
    if found is None:
        best = max(estimates, key=lambda e: e.explained)
        return (
            f"<p>The edge of Snell's window is not seen clearly enough to tell whether the plate is level (at best it "
            f"explains {100.0 * best.explained:.0f} % of the brightness about it, {best.contrast:.1f} : 1). Take a "
            f"GoPro's gravity track, or level it by eye. {said}</p>"
        )
    roll, pitch, spread = np.degrees(found)
    count = sum(e.reliable for e in estimates)
    text = (
        f"<p>Snell's window suggests roll {roll:z.1f}, pitch {pitch:z.1f} degrees, in {count} of "
        f"{len(estimates)} frames, which differ by {spread:.1f} degrees (rms). Waves alone move the window by one or "
        f"two. {said}</p>"
    )
    if spread > _STEADY_DEG:
        return text + "<p>The camera turns: give its gravity track or <code>camera.tilt_keys</code> over time.</p>"
    if np.hypot(roll, pitch) < _LEVEL_DEG:
        return text + "<p>As far as the window tells, the plate is level.</p>"
    return text + f"<pre>[camera]\nroll_deg = {roll:z.1f}\npitch_deg = {pitch:z.1f}</pre>"


def picture(image_encoded: ArrayLike, caption: str, width: int | None = None) -> str:
    """Return an HTML figure of code values (H, W, 3) in [0, 1], as an embedded PNG."""
    return _figure(np.round(255.0 * np.clip(image_encoded, 0.0, 1.0)).astype(np.uint8), caption, width)


def _figure(codes: NDArray[np.uint8], caption: str, width: int | None = None) -> str:
    """Return an HTML figure of codes (h, w, 3), as an embedded PNG."""
    text = base64.b64encode(encoded(codes, ".png")).decode("ascii")
    size = f' width="{width}"' if width else ""
    caption = html.escape(caption)
    return (
        f'<figure><img alt="{caption}"{size} src="data:image/png;base64,{text}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def irradiance_ball(irradiance: Floats) -> Floats:
    """Return a white ball lit by an irradiance map, seen along -z, as code values (192, 192, 3)."""
    x = (np.arange(192) + 0.5) / 96.0 - 1.0
    px, py = np.meshgrid(x, -x)
    inside = px**2 + py**2 < 1.0
    normal = np.stack([px, py, np.sqrt(np.maximum(1.0 - px**2 - py**2, 0.0))], axis=-1)
    radiance = environment_lookup(irradiance, normal) / np.pi
    exposed = 0.8 * radiance / max(float(radiance[inside].max()), 1e-9)
    return np.where(inside[..., None], encode(exposed, "srgb"), 1.0)


def marked(image_encoded: Floats, sun: Sun | None) -> Floats:
    """Return a picture (H, W, 3) with a ring about the sun."""
    import cv2

    out = np.ascontiguousarray(image_encoded, np.float32)
    if sun is not None:
        height, width = out.shape[:2]
        x, y = frame_from_direction(sun.direction, width, height)
        cv2.circle(out, (int(x), int(y)), max(width // 60, 6), (1.0, 0.2, 0.0), 2, cv2.LINE_AA)
    return out


def frame_section(time_s: float, plate_linear: Floats, light: Environment, sun_in_words: str = "") -> tuple[str, str]:
    """Return title and HTML fragment of a frame (H, W, 3), made small beforehand, and its light.

    sun_in_words: on its sun; "" says what the light has.
    """
    reach = max(float(np.percentile(light.radiance, 99.0)), 1e-6)
    radiance = np.repeat(np.repeat(light.radiance, 8, axis=0), 8, axis=1)
    sun = light.sun
    words = sun_in_words or ("no sun" if sun is None else f"sun marked, confidence {sun.confidence:.2f}")
    parts = (
        picture(marked(encode(np.clip(plate_linear, 0, 1), "srgb"), sun), f"Plate ({words})"),
        '<div class="row">',
        picture(marked(encode(radiance / reach, "srgb"), sun), "Expanded radiance, 64 x 32, 99th percentile white"),
        picture(irradiance_ball(light.irradiance), "White ball in this light", 192),
        picture(irradiance_ball(light.ambient), "The same without the sun's beam", 192),
        "</div>",
    )
    return f"Frame at {time_s:.2f} s", "".join(parts)


def _summary(track: SunTrack) -> str:
    seen = float(np.mean(np.isfinite(track.raw_direction[:, 0])))
    rows = [
        ("frames", f"{len(track)}"),
        ("shots", f"{len(track.cuts) + 1}"),
        ("frames that show a sun", f"{100.0 * seen:.0f} %"),
        ("mean confidence", f"{float(np.mean(track.confidence)):.2f}"),
    ]
    return "<table>" + "".join(f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in rows) + "</table>"


def _plots(track: SunTrack) -> list[str]:
    cuts = [float(track.times_s[k]) for k in track.cuts]

    def strength(light: Floats) -> Floats:
        return np.log10(np.maximum(light.mean(axis=1), 1e-6))

    angles = zip(angles_deg(track.raw_direction), angles_deg(track.direction), strict=True)
    pairs = [
        *((f"{name} of the sun [deg]", *both) for name, both in zip(("azimuth", "elevation"), angles, strict=True)),
        ("irradiance of the sun, log10", strength(track.raw_irradiance), strength(track.irradiance)),
        ("confidence", track.raw_confidence, track.confidence),
    ]
    plots = [
        svg_plot(track.times_s, [("raw", a, True), ("smoothed", b, False)], name, cuts, "s") for name, a, b in pairs
    ]
    stops = np.log2(np.maximum(track.exposure, 1e-6) / max(float(np.median(track.exposure)), 1e-6))
    return [
        *plots,
        svg_plot(track.times_s, [("log-mean luminance", stops, False)], "exposure, stops about its median", cuts, "s"),
    ]
