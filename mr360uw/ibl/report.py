# SPDX-License-Identifier: Apache-2.0
"""HTML report on the light of a clip: one file with its pictures and plots inside, readable offline.

Plate and expanded map with the sun marked, a ball lit by the irradiance, and over time the sun's direction, strength
and confidence, measured and smoothed, with the exposure. Other stages add sections of their own.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.base.color import encode
from mr360uw.base.sphere import frame_from_direction
from mr360uw.ibl.lookup import environment_lookup
from mr360uw.ibl.sun.track import SunTrack, angles_deg
from mr360uw.ibl.tilt import HorizonEstimate, clip_horizon, roll_pitch
from mr360uw.types import Environment, Floats, Sun

_WIDTH, _HEIGHT, _MARGIN = 900, 200, 54
_STEADY_DEG, _LEVEL_DEG = 3.0, 2.0
_COLOURS = ("#0b6e99", "#c2410c", "#4d7c0f")
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #16202a; max-width: 960px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; border-bottom: 1px solid #d5dde3; }
img, svg { max-width: 100%; display: block; } figure { margin: 1em 0; } figcaption { color: #52606d; }
.row { display: flex; gap: 1em; flex-wrap: wrap; } .row > * { flex: 1 1 260px; }
table { border-collapse: collapse; } td, th { padding: .2em .9em .2em 0; text-align: left; }
"""


@dataclass(frozen=True, slots=True)
class ReportFrame:
    """One frame to show. plate_linear: (H, W, 3), made small beforehand. sun_in_words: on its sun, or ""."""

    time_s: float
    plate_linear: Floats
    environment: Environment
    sun_in_words: str = ""


def light_report(
    title: str,
    snapshots: Sequence[ReportFrame],
    track: SunTrack | None = None,
    sections: Sequence[tuple[str, str]] = (),
) -> str:
    """Return the page as one HTML string. `sections`: more (title, HTML fragment) pairs, put at the end as they are."""
    parts = [f"<h1>{html.escape(title)}</h1>"]
    if track is not None:
        parts += ["<h2>Sun</h2>", _summary(track), *_plots(track)]
    for snapshot in snapshots:
        parts += [f"<h2>Frame at {snapshot.time_s:.2f} s</h2>", _frame(snapshot)]
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
    roll, pitch, spread = np.degrees([found.roll_rad, found.pitch_rad, found.spread_rad])
    text = (
        f"<p>Snell's window suggests roll {roll:z.1f}, pitch {pitch:z.1f} degrees, in {found.frames} of "
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
    import cv2

    pixels = np.round(255.0 * np.clip(image_encoded, 0.0, 1.0)).astype(np.uint8)
    _, data = cv2.imencode(".png", np.ascontiguousarray(pixels[..., ::-1]))
    text = base64.b64encode(data.tobytes()).decode("ascii")
    size = f' width="{width}"' if width else ""
    caption = html.escape(caption)
    return (
        f'<figure><img alt="{caption}"{size} src="data:image/png;base64,{text}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def plot(
    x: ArrayLike,
    curves: Sequence[tuple[str, ArrayLike, bool]],
    label: str,
    cuts: Sequence[float] = (),
) -> str:
    """Return an inline SVG plot of curves (name, y, as dots) over x; gaps where y is not finite, lines at `cuts`."""
    # Find the range of the axes, with a rim above and below the curves
    x = np.asarray(x, np.float64)
    columns = [np.asarray(y, np.float64) for _, y, _ in curves]
    finite = np.concatenate([c[np.isfinite(c)] for c in columns] + [np.zeros(0)])
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    pad = 0.06 * (high - low) or 0.5
    low, high = low - pad, high + pad
    left, right = (float(x[0]), float(x[-1])) if len(x) > 1 else (0.0, 1.0)

    def place(px: NDArray[np.float64], py: NDArray[np.float64]) -> NDArray[np.float64]:
        across = _MARGIN + (px - left) / (right - left) * (_WIDTH - _MARGIN - 10)
        return np.stack([across, 10 + (high - py) / (high - low) * (_HEIGHT - 40)], axis=-1)

    # Draw the grid with its numbers, and lines at cuts
    out = [f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{html.escape(label)}">']
    for value in np.linspace(low + pad, high - pad, 3):
        y = place(np.array([left]), np.array([value]))[0, 1]
        out.append(f'<path d="M{_MARGIN} {y:.1f}H{_WIDTH - 10}" stroke="#e3e9ee"/>')
        out.append(f'<text x="{_MARGIN - 6}" y="{y + 4:.1f}" font-size="11" text-anchor="end">{value:.4g}</text>')
    for value in np.linspace(left, right, 5):
        px = place(np.array([value]), np.array([low]))[0, 0]
        out.append(f'<text x="{px:.1f}" y="{_HEIGHT - 12}" font-size="11" text-anchor="middle">{value:.4g} s</text>')
    for cut in cuts:
        px = place(np.array([cut]), np.array([low]))[0, 0]
        out.append(f'<path d="M{px:.1f} 10V{_HEIGHT - 30}" stroke="#9aa7b2" stroke-dasharray="4 3"/>')
    # Draw each curve as dots, or as lines between its gaps
    for k, ((_, _, dots), column) in enumerate(zip(curves, columns, strict=True)):
        points, good = place(x, column), np.isfinite(column)
        colour = _COLOURS[k % len(_COLOURS)]
        if dots:
            marks = "".join(f"M{px:.1f} {py:.1f}h.01" for px, py in points[good])
            out.append(f'<path d="{marks}" stroke="{colour}" stroke-width="3" stroke-linecap="round" opacity=".45"/>')
        else:
            runs = np.split(np.flatnonzero(good), np.flatnonzero(np.diff(np.flatnonzero(good)) > 1) + 1)
            lines = "".join("M" + "L".join(f"{px:.1f} {py:.1f}" for px, py in points[run]) for run in runs if len(run))
            out.append(f'<path d="{lines}" fill="none" stroke="{colour}" stroke-width="1.6"/>')
    out.append("</svg>")
    # Name the curves below the plot
    signs = [("&bull;" if dots else "&mdash;") + " " + html.escape(name) for name, _, dots in curves]
    key = " &nbsp; ".join(f'<span style="color:{_COLOURS[k % 3]}">{sign}</span>' for k, sign in enumerate(signs))
    return f"<figure>{''.join(out)}<figcaption>{html.escape(label)}: {key}</figcaption></figure>"


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


def _frame(snapshot: ReportFrame) -> str:
    light = snapshot.environment
    reach = max(float(np.percentile(light.radiance, 99.0)), 1e-6)
    radiance = np.repeat(np.repeat(light.radiance, 8, axis=0), 8, axis=1)
    sun = light.sun
    words = snapshot.sun_in_words or ("no sun" if sun is None else f"sun marked, confidence {sun.confidence:.2f}")
    return "".join(
        [
            picture(marked(encode(np.clip(snapshot.plate_linear, 0, 1), "srgb"), sun), f"Plate ({words})"),
            '<div class="row">',
            picture(marked(encode(radiance / reach, "srgb"), sun), "Expanded radiance, 64 x 32, 99th percentile white"),
            picture(irradiance_ball(light.irradiance), "White ball in this light", 192),
            picture(irradiance_ball(light.ambient), "The same without the sun's beam", 192),
            "</div>",
        ]
    )


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
    plots = [plot(track.times_s, [("raw", a, True), ("smoothed", b, False)], name, cuts) for name, a, b in pairs]
    stops = np.log2(np.maximum(track.exposure, 1e-6) / max(float(np.median(track.exposure)), 1e-6))
    return [
        *plots,
        plot(track.times_s, [("log-mean luminance", stops, False)], "exposure, stops about its median", cuts),
    ]
