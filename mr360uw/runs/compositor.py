# SPDX-License-Identifier: Apache-2.0
"""Compositing of single frames by a library call: one frame, or many with a scene that is loaded once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Self

import numpy as np
from pydantic import NonNegativeFloat, NonNegativeInt

from mr360uw.base.cache import Cache
from mr360uw.base.constants import MOST_LIGHT
from mr360uw.base.parameters import checked, file_path, is_light, real
from mr360uw.base.progress import Progress, one_blas_thread, prefetch
from mr360uw.errors import ParameterError
from mr360uw.render.first_pass import ClipAnalysis, clip_analysis
from mr360uw.render.frame import (
    Backend,
    Frame,
    FrameShots,
    blend_frame,
    close_backend,
    composite_frame,
    draw_frame,
    frame_shots,
    make_backend,
)
from mr360uw.render.loaded import Loaded, load
from mr360uw.render.plate_light import LightSamples
from mr360uw.scene.model import Scene
from mr360uw.scene.resolved import open_plate
from mr360uw.types import CausticStack, Environment, Floats, Layer, MediumTable, Sun
from mr360uw.video import VideoFrame, VideoReader


@dataclass(frozen=True, slots=True)
class FrameResult:
    """One composited frame and its intermediate results; stages that the scene does not need are None.

    The picture is what a video would get, before it is encoded. The other fields show why it looks so: which sun was
    found, how bright the ambient light is, what the objects cover.

    Parameters
    ----------
    image_linear : ndarray
        The frame (H, W, 3), float32, linear Rec.709, white is 1; bodies keep what is above the plate's brightest code.
    layer : Layer
        Objects, their shadows and caustics, as they are laid over the plate.
    environment : Environment or None
        The plate's light.
    caustics : CausticStack or None
        Caustics on planes around the objects' depths.
    medium : MediumTable or None
        The water, its veil matched to the plate.

    See Also
    --------
    uw.render_frame : Makes one.
    uw.Compositor.frames : Makes those of a clip.
    uw.composite.over_tile : Lays a tile of the layer over a plate.

    Examples
    --------
    >>> result = uw.render_frame(plate, scene, backend="reference")
    >>> result.image_linear.shape
    (32, 64, 3)
    >>> bool(result.layer.alpha.max() > 0.9)
    True
    """

    image_linear: Floats
    layer: Layer
    environment: Environment | None
    caustics: CausticStack | None
    medium: MediumTable | None

    def _repr_png_(self) -> bytes:
        """Return the frame as a notebook shows it: 8-bit sRGB, at most 1024 pixels wide."""
        from mr360uw.preview.screen import LARGEST_WIDTH, screen_picture

        return screen_picture(self.image_linear, ".png", width=LARGEST_WIDTH)


class Compositor:
    """Composites frames with one scene, which is loaded once: from the second frame on only the frame is computed.

    A frame depends on its plate, index and time alone, never on the frames made before it. `frames` takes the light of
    most frames of a clip from frames before and after, and gives the frames of `composite_video`; `frame` measures it
    in the plate that it is given. Frames are made in the thread that made the compositor, as OpenGL asks for; `frames`
    decodes the next ones meanwhile on a thread of its own. Any thread may close it.

    Parameters
    ----------
    scene : Scene
        A scene of a file (`load_scene`), or made in Python.
    backend : {"auto", "gl", "reference"}
        The renderer; "auto" takes OpenGL where it can be had.
    analysis : ClipAnalysis, optional
        Of the frames' clip (`analyse_clip`); without it the light of a frame is measured in that frame alone.

    Raises
    ------
    ParameterError
        If the scene is no `Scene`, or the compositor is closed.
    GlError
        If OpenGL is asked for and cannot be had.
    SceneError
        If a file of the scene cannot be used.

    See Also
    --------
    uw.composite_video : Writes the frames to a file, and goes on after a stop.
    uw.render_frame : One frame by one call.
    uw.analyse_clip : Measures a clip once for several compositors.

    Examples
    --------
    >>> with uw.Compositor(scene, backend="reference") as compositor:
    ...     pictures = [compositor.frame(plate, time_s).image_linear for time_s in (0.0, 0.5)]
    >>> pictures[1].shape
    (32, 64, 3)
    """

    @checked
    def __init__(self, scene: Scene, *, backend: str = "auto", analysis: ClipAnalysis | None = None) -> None:
        self._scene = scene
        self._analysis = analysis
        self._renderer, self.note = make_backend(backend)
        self._loaded: Loaded | None = None
        self._kept: Cache | None = Cache(scene.plate.eyes)
        self._one_thread = threading.Lock()

    @checked
    def frame(
        self,
        plate: Floats | VideoFrame,
        time_s: float = 0.0,
        *,
        index: NonNegativeInt = 0,
        sun: Sun | Literal["scene"] | None = "scene",
        gain: Floats | None = None,
        shutter_s: NonNegativeFloat = 0.0,
    ) -> FrameResult:
        """Return the composite of one plate.

        For frames of one's own, in any order. Without an analysis the light is measured in this plate alone, so
        brightness may flicker from frame to frame where that of `frames` does not.

        Parameters
        ----------
        plate : ndarray or VideoFrame
            A panorama (H, 2 H, 3), linear float, values up to 1 where it clips; or a frame of `open_video`, which
            brings its index and time, and whose light is read from its codes as `composite_video` does.
        time_s : float
            Time [s] of the sea and of moving objects.
        index : int
            Number of the frame, for sequences, grain and the analysis.
        sun : Sun or "scene" or None
            The sun in the world, None for none; "scene" follows the scene's settings in this plate alone. Without an
            analysis only.
        gain : ndarray, optional
            Gain (3,) of the veil if the scene's is "auto"; None fits it to this plate alone. Without an analysis only.
        shutter_s : float
            Exposure time [s], for motion blur.

        Returns
        -------
        FrameResult
            The frame, linear, and its layers.

        Raises
        ------
        ParameterError
            If the plate is no panorama of linear light, or the compositor is closed.

        See Also
        --------
        uw.Compositor.frames : Frames of a clip, with light that is smooth in time.
        uw.render_frame : The same for a single frame.

        Examples
        --------
        >>> with uw.Compositor(scene, backend="reference") as compositor:
        ...     result = compositor.frame(plate, time_s=0.5, sun=None)
        >>> result.image_linear.dtype.name
        'float32'
        """
        with self._one_thread:
            shown = plate if isinstance(plate, VideoFrame) else VideoFrame.of_linear(_checked(plate), index, time_s)
            loaded = self._loaded_for(*shown.shape, clip=self._analysis is not None)
            analysis = ClipAnalysis.of_frame(sun, gain) if self._analysis is None else self._analysis
            frame = composite_frame(loaded, analysis, self._renderer, shown, shutter_s, cache=self._cache())
            return result_of(frame)

    @checked
    def frames(
        self, start: int = 0, stop: int | None = None, *, video: VideoReader | None = None
    ) -> Iterator[FrameResult]:
        """Yield the composites of a clip's frames, those that `composite_video` writes.

        Without an analysis the clip is first read from end to end, however short the range, where the scene needs
        measurements; `analyse_clip` with `frames` reads only what is near the range.

        Parameters
        ----------
        start, stop : int, optional
            Frames [start, stop); by default all.
        video : VideoReader, optional
            The clip, open; by default the plate that the scene names. Without an analysis it is analysed first.

        Yields
        ------
        FrameResult
            A frame and its layers, in the order of the clip.

        Raises
        ------
        ParameterError
            If the video is not open, or the compositor is closed.
        VideoError
            If a frame cannot be decoded.

        See Also
        --------
        uw.composite_video : Writes these frames to a file.
        uw.Compositor.frame : A frame of one's own.
        uw.analyse_clip : Measures a clip once for several scenes.

        Examples
        --------
        >>> with uw.Compositor(scene, backend="reference") as compositor:
        ...     [result.image_linear.shape for result in compositor.frames(0, 1)]
        [(32, 64, 3)]
        """
        if video is None:
            with open_plate(self._scene) as own:
                yield from self.frames(start, stop, video=own)
            return
        start, stop, _ = slice(start, stop).indices(video.frame_count or 1)
        with self._one_thread:
            loaded = self._loaded_for(video.height, video.width, clip=not video.is_still)
            analysis = clip_analysis(loaded, video) if self._analysis is None else self._analysis
        shots_of_all = shots_of_clip(loaded, analysis, self._renderer, video, video.frames, start, stop)
        with closing(prefetch(shots_of_all)) as frames:
            for shots in frames:
                with self._one_thread, one_blas_thread():
                    drawn = draw_frame(self._renderer, shots, self._cache())
                    result = result_of(blend_frame(loaded, analysis, shots, drawn, self._cache()))
                yield result

    def _cache(self) -> Cache:
        """Return what is kept from frame to frame."""
        if self._kept is None:
            raise ParameterError("compositor - is closed - make another")
        return self._kept

    def _loaded_for(self, height: int, width: int, *, clip: bool) -> Loaded:
        """Return the scene, loaded for plates of a size."""
        self._cache()
        if self._loaded is None or (self._loaded.height, self._loaded.width) != (height, width):
            self._loaded = load(self._scene, width, height, clip=clip)
        return self._loaded

    def close(self) -> None:
        """Release everything that is cached, after the frame that is being made: arrays, and objects on the device.

        The end of a `with` block does the same. A closed compositor makes no more frames.

        See Also
        --------
        uw.Compositor : Makes frames until it is closed.

        Examples
        --------
        >>> compositor = uw.Compositor(scene, backend="reference")
        >>> compositor.close()
        """
        with self._one_thread:
            self._loaded = self._kept = self._analysis = None
            close_backend(self._renderer)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


Decode = Callable[[int, int], Iterator[VideoFrame]]
"""Yields the frames [a, b) of a clip, as `VideoReader.frames` does."""


def shots_of_clip(
    loaded: Loaded, analysis: ClipAnalysis, backend: Backend, video: VideoReader, decode: Decode, start: int, stop: int
) -> Iterator[FrameShots]:
    """Yield what is to be drawn for frames [start, stop) of a clip, with their light measured, on any thread."""
    cache, exposure_s = Cache(loaded.scene.plate.eyes), loaded.scene.draw.exposure_s(video.frame_rate)
    for plate, light in LightSamples(loaded, analysis, video, decode).frames(start, stop):
        yield frame_shots(loaded, analysis, backend, plate, exposure_s, cache, light)


def result_of(frame: Frame) -> FrameResult:
    """Return a frame as callers get it."""
    return FrameResult(
        image_linear=frame.picture.light,
        layer=frame.layer.laid(),
        environment=frame.light.environment if frame.light is not None else None,
        caustics=frame.caustics,
        medium=frame.medium,
    )


@checked
def render_frame(
    plate: Floats | VideoFrame,
    scene: Scene,
    time_s: float = 0.0,
    backend: str = "auto",
    *,
    index: NonNegativeInt = 0,
    sun: Sun | Literal["scene"] | None = "scene",
    gain: Floats | None = None,
    analysis: ClipAnalysis | None = None,
    shutter_s: NonNegativeFloat = 0.0,
) -> FrameResult:
    """Return the composite of one plate; for more than one a `Compositor` is faster.

    The scene is loaded for this call alone. Unless an analysis is given, the light is measured in this plate alone: a
    video made frame by frame may flicker.

    Parameters
    ----------
    plate : ndarray or VideoFrame
        A panorama (H, 2 H, 3), linear float, white is 1; or a frame of `open_video`.
    scene : Scene
        What is put into it, and the water.
    time_s : float
        Time [s] of the sea and of moving objects.
    backend : {"auto", "gl", "reference"}
        The renderer.
    index : int
        Number of the frame, for sequences and grain.
    sun : Sun or "scene" or None
        The sun in the world, None for none; "scene" follows the scene's settings.
    gain : ndarray, optional
        Gain (3,) of the veil; None fits it to the plate if the scene's is "auto".
    analysis : ClipAnalysis, optional
        Of the plate's clip; instead of sun and gain.
    shutter_s : float
        Exposure time [s], for motion blur.

    Returns
    -------
    FrameResult
        The frame, linear, and its layers.

    Raises
    ------
    ParameterError
        If the plate is no panorama of linear light.
    SceneError
        If a file of the scene cannot be used.

    See Also
    --------
    uw.Compositor : Keeps the scene for many frames.
    uw.composite_video : Makes a whole video.

    Examples
    --------
    >>> result = uw.render_frame(plate, scene, time_s=0.5, backend="reference")
    >>> result.image_linear.shape
    (32, 64, 3)
    """
    with Compositor(scene, backend=backend, analysis=analysis) as compositor:
        return compositor.frame(plate, time_s, index=index, sun=sun, gain=gain, shutter_s=shutter_s)


@checked
def analyse_clip(
    video: str | Path, scene: Scene, *, frames: tuple[int, int] | None = None, progress: Progress | None = None
) -> ClipAnalysis:
    """Return what a composite measures over a clip before its first frame: sun, gain of the veil, background, grade.

    It reads the clip once. Given to several compositors, it saves each of them that pass, and all have the same light.

    Parameters
    ----------
    video : str or Path
        The clip, instead of the plate that the scene names.
    scene : Scene
        Says what has to be measured.
    frames : tuple of int, optional
        Frames [a, b), measured with ten seconds on either side; by default all.
    progress : callable, optional
        Is called with (done, total) frames.

    Returns
    -------
    ClipAnalysis
        For `Compositor(scene, analysis=...)`, of this scene or of others with the same clip.

    Raises
    ------
    VideoError
        If the clip cannot be read.
    SceneError
        If a file of the scene cannot be used.

    See Also
    --------
    uw.Compositor : Takes the analysis.
    uw.ClipAnalysis : What is returned.

    Examples
    --------
    >>> analysis = uw.analyse_clip("dive.mp4", scene)
    >>> analysis.gain.shape
    (2, 3)
    """
    plate = scene.plate.model_copy(update={"path": file_path("video", video)})
    with open_plate(scene.model_copy(update={"plate": plate})) as reader:
        loaded = load(scene, reader.width, reader.height, clip=not reader.is_still)
        return clip_analysis(loaded, reader, progress, frames=frames)


def _checked(plate: Floats) -> Floats:
    """Return a plate of linear light; raise `ParameterError` for other arrays."""
    plate = real("plate", plate)
    if plate.ndim != 3 or plate.shape[2] != 3 or plate.shape[1] != 2 * plate.shape[0] or plate.shape[0] % 2:
        raise ParameterError(
            f"plate - must be an equirectangular image (H, 2 H, 3) of even height (got {plate.shape}) - resize it"
        )
    if not np.issubdtype(plate.dtype, np.floating) or not is_light(plate):
        raise ParameterError(
            f"plate - must be floating point light, finite and within {MOST_LIGHT:g} (got {plate.dtype}) - decode code "
            "values with uw.open_video"
        )
    return plate
