# SPDX-License-Identifier: Apache-2.0
"""A page with the viewer and the time line alone, for tests in a browser: python -m tests.tune.harness PORT.

Every event that reaches Python is kept and served at /told; /do/NAME calls a method of an element.
"""

from __future__ import annotations

import asyncio
import json
import sys
from typing import Any

import numpy as np
from fastapi import Request, Response
from nicegui import app, ui

from mr360uw.preview.screen import encoded
from mr360uw.tune.controls import Timeline
from mr360uw.tune.placing import Point
from mr360uw.tune.situation import Marker, Viewer

COUNT, RATE = 300, 30.0
WIDTH = 512
TOLD: list[tuple[str, Any]] = []
NOW: dict[str, Any] = {}


def picture(red: float, width: int = WIDTH, height: int = WIDTH // 2) -> np.ndarray:
    """Return a picture (H, W, 3) whose red is a constant, whose green is its column and whose blue is its row."""
    row, column = np.mgrid[0:height, 0:width]
    return np.stack([np.full_like(row, red), column * 255 // (width - 1), row * 255 // (height - 1)], -1).astype(
        np.uint8
    )


@app.get("/picture/{red}.png")
def _picture(red: int) -> Response:
    return Response(encoded(picture(red), ".png"), media_type="image/png")


@app.get("/small/{red}.png")
def _small(red: int) -> Response:
    return Response(encoded(picture(red, 64, 32), ".png"), media_type="image/png")


@app.get("/slow/{red}.png")
async def _slow(red: int) -> Response:
    await asyncio.sleep(0.4)
    return _picture(red)


@app.get("/plan.png")
def _plan() -> Response:
    return Response(encoded(picture(128, 256, 256), ".png"), media_type="image/png")


@app.get("/told")
def _told() -> list[Any]:
    return json.loads(json.dumps(TOLD))


@app.post("/do/{element}/{method}")
async def _do(element: str, method: str, request: Request) -> None:
    arguments = await request.json()
    with NOW[element].client:
        getattr(NOW[element], method)(**arguments)


def note(name: str) -> Any:
    return lambda *told: TOLD.append((name, list(told)))


def curve(keys: tuple[tuple[float, float], ...], interpolation: str = "linear") -> dict[str, Any]:
    times = np.linspace(0.0, COUNT / RATE, 200)
    values = np.interp(times, *np.transpose(keys)) if keys else np.full(200, 4.0)
    samples = tuple(zip(times.tolist(), values.tolist(), strict=True))
    return {
        "label": "Wind speed", "unit": "m/s", "keys": keys, "samples": samples, "interpolation": interpolation,
        "low": 0.0, "high": 40.0,
    }  # fmt: skip


@app.post("/fresh")
async def _fresh() -> None:
    """Replace the elements of the page by new ones: a page that is loaded takes a second, elements do not."""
    TOLD.clear()
    with NOW["root"].client:
        NOW["root"].clear()
        with NOW["root"]:
            build()


def build() -> None:
    with ui.element("div").classes("w-full").style("flex: 1 1 0; min-height: 0"):
        viewer = Viewer()
    timeline = Timeline(COUNT, RATE)
    NOW.update(viewer=viewer, timeline=timeline)
    viewer.on_select(note("select"))
    for name in ("pick", "stroke", "drag", "view"):
        viewer.on(name, lambda event, name=name: note(name)(event.args))
    viewer.on("shown", lambda event: note("shown")(event.args["serial"]))
    viewer.on("failed", lambda event: note("failed")(event.args["reason"]))
    viewer.on_select(viewer.select)
    timeline.on_play(note("play"))
    timeline.on_range(note("range"))
    for name in ("seek", "keys"):
        timeline.on(name, lambda event, name=name: note(name)(event.args))
    timeline.on_keys(lambda keys, kind, done: timeline.set_curve(curve(tuple(keys), kind)))  # noqa: ARG005
    viewer.show("/picture/200.png")
    viewer.show_other("/picture/40.png")
    horizon = [Point(a, -0.12) for a in np.linspace(-np.pi, np.pi, 181)]
    viewer.set_marks(
        [
            Marker("whale", 0.35, -0.1, "object", "Whale", 0.25),
            Marker("sun", -0.4, 0.9, "sun", "Sun"),
            Marker("lamp", -0.8, -0.3, "lamp", "Lamp 1"),
        ],
        [horizon],
    )
    timeline.set_thumbnails({f: f"/small/{f % 256}.png" for f in range(0, COUNT, 60)})
    timeline.set_curve(curve(((1.0, 4.0), (5.0, 12.0), (8.0, 6.0))))


@ui.page("/")
def page(dark: int = 0) -> None:
    ui.dark_mode(value=bool(dark))
    ui.query(".nicegui-content").classes("p-0 gap-0")
    NOW["root"] = ui.column().classes("w-full gap-0").style("height: 100vh")
    with NOW["root"]:
        build()


if __name__ in {"__main__", "__mp_main__"}:
    ui.run(host="127.0.0.1", port=int(sys.argv[1]), show=False, reload=False, title="Viewer", favicon="🐋")
