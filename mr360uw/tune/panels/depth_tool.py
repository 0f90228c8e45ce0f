# SPDX-License-Identifier: Apache-2.0
"""The page's "Find depth": runs `mr360uw depth` on the plate, shows how far it is, and names the maps in the scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from nicegui import background_tasks, ui

from mr360uw.constants import DEPTH_EYES_S, DEPTH_FRAME_S
from mr360uw.errors import ParameterError
from mr360uw.tune.panels.widgets import Button
from mr360uw.tune.session import CommandRun, Session

_TITLE = (
    "find how far away everything in the plate is, from the motion of its camera or by its two eyes: bodies then go "
    "behind what is nearer. A frame takes about {:.1f} s, all {} about {:.0f} min; press again to stop, what is found "
    "stays"
)


class DepthTool:
    """The button of a tab; pressed again, it ends the run. failed: tells an error."""

    def __init__(self, session: Session, failed: Callable[[Exception], None]) -> None:
        self._session, self._failed = session, failed
        self._run: CommandRun | None = None
        frames = session.frame_count
        eyes = session.document.scene.plate.eye == "both"
        frame_s = DEPTH_EYES_S if eyes else DEPTH_FRAME_S
        title = _TITLE.format(frame_s, frames, max(frames * frame_s / 60.0, 1.0))
        self._button = Button("Find depth", self._pressed, title=title)
        self._button.set_visibility(frames > 1 or eyes)

    def _pressed(self) -> None:
        if self._run is not None:
            self._run.cancel()
            return
        scene, path = self._session.document.scene, self._session.document.path
        folder = path.with_name(f"{path.stem}.depth")
        command = ["depth", str(scene.plate.path), "-o", str(folder)]
        if scene.plate.eye == "both":
            command += ["--eye", "both", "--ipd", str(scene.camera.ipd_m)]
        elif scene.camera.track is None:
            self._failed(
                ParameterError(
                    "camera.track - is not set, so distances have no scale (got none) - run mr360uw track on the plate "
                    "with --height, and name the table"
                )
            )
            return
        else:
            command += ["--track", str(scene.camera.track)]
            command += [] if scene.plate.eye is None else ["--eye", scene.plate.eye]
        self._run = CommandRun(folder, self._show)
        background_tasks.create(self._finish(self._run, [*command, "--progress-lines"]), name="depth")

    async def _finish(self, run: CommandRun, command: list[str]) -> None:
        self._show()
        try:
            await run.run(command)
        finally:
            self._run = None
            self._show()
        if run.state == "failed":
            self._failed(ParameterError(run.message))
        elif run.state == "done":
            self._session.document.set("plate.depth", Path(run.out).name)
            if not self._button.is_deleted:
                with self._button.client:
                    ui.notify(run.message, type="positive", timeout=8000, close_button="Close")

    def _show(self) -> None:
        run = self._run
        if not self._button.is_deleted:
            share = f" {100 * run.done // run.total} %" if run is not None and run.total else " …"
            self._button.text = "Find depth" if run is None else f"Finding depth{share}, stop"
            self._button.press(run is not None)
