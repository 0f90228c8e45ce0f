# SPDX-License-Identifier: Apache-2.0
"""The two renderers behind one interface, and the choice between them.

`reference` casts rays in float64 NumPy, defines the right answer and needs no OpenGL. `gl` computes the same with
OpenGL 3.3.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Literal, Protocol, get_args

from mr360uw.cache import Cache, drop_shared
from mr360uw.caustics.settings import CausticSettings, Sea
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.shot import Shot
from mr360uw.errors import GlError, ParameterError
from mr360uw.steps import Pause, Steps
from mr360uw.types import BeamSpread, CausticStack, Floats, Layer

if TYPE_CHECKING:
    from mr360uw.composite.gl.layer_renderer import LayerRenderer

BackendName = Literal["auto", "gl", "reference"]
_ON_DEVICE, _ON_PROCESSOR = 5, 0
"""Frames under way at a time. A frame of bodies that move waits four times for a device, so with four of them and one
that is put together there is one wait a frame; each takes memory. Where the processor draws, one after the other: two
at a time took a tenth more processor time and memory on two cores, and no less time."""


class Backend(Protocol):
    """The stages that a renderer computes: caustics and the layer of objects.

    blends: whether it is a graphics card, which then also blends the frames of a clip. cache: values kept between
    frames; may be emptied. in_flight: how many frames are best under way at a time.
    """

    name: str
    device: str
    blends: bool
    cache: Cache
    in_flight: int

    def caustics(
        self,
        sea: Sea,
        sun_in_air: Floats,
        depths_m: Floats,
        time_s: float,
        settings: CausticSettings,
        refractive_index: float,
        spread: BeamSpread | None,
    ) -> CausticStack:
        """Return the caustics on planes."""

    def layer(self, shot: Shot, *, variables: bool = False) -> Steps[tuple[Layer, Aovs | None]]:
        """Return the layer of a shot, and its output variables if asked for (else None)."""

    def answer(self) -> None:
        """Take from the device what the steps under way wait for."""

    def release(self) -> None:
        """Let go of all that is kept between frames, here and on the device; a later frame makes it anew."""


class Reference:
    """The reference renderer: float64 on the processor. cache: see `Backend`."""

    name = "reference"
    device = "processor, float64"
    blends = False
    in_flight = 0

    def __init__(self, cache: Cache | None = None) -> None:
        self.cache = Cache() if cache is None else cache

    def caustics(
        self,
        sea: Sea,
        sun_in_air: Floats,
        depths_m: Floats,
        time_s: float,
        settings: CausticSettings,
        refractive_index: float,
        spread: BeamSpread | None,
    ) -> CausticStack:
        """Return the caustics of `mr360uw.caustics.caustic_stack`."""
        from mr360uw.caustics import caustic_stack

        return caustic_stack(sea, sun_in_air, depths_m, time_s, settings, refractive_index, spread)

    def layer(self, shot: Shot, *, variables: bool = False) -> Steps[tuple[Layer, Aovs | None]]:
        """Return the layer of `mr360uw.composite.reference`, in one step."""
        from mr360uw.composite.reference import render_aovs, render_layer

        yield Pause.REST
        return render_aovs(shot, self.cache) if variables else (render_layer(shot, self.cache), None)

    def answer(self) -> None:
        """Return at once: there is no device."""

    def release(self) -> None:
        """Empty the cache."""
        self.cache.clear()


class Gl:
    """The OpenGL renderer, for the thread that made it. blends, cache: see `Backend`.

    note: a line that says why a graphics card does not blend, or "".
    """

    name = "gl"

    def __init__(self, cache: Cache | None = None) -> None:
        from mr360uw.composite.gl.layer_renderer import LayerRenderer
        from mr360uw.gl.context import gl_device

        device = gl_device()
        self.device, self.blends, self.note = device.renderer, False, ""
        if not device.software:  # which takes longer for it than the processor without OpenGL
            from mr360uw.render.blend_trial import doubt_of_blending

            doubt = doubt_of_blending()
            self.blends = not doubt
            self.note = doubt and f"{self.device} blends wrongly, so the processor blends ({doubt})"
        self.in_flight = _ON_PROCESSOR if device.software else _ON_DEVICE
        self.cache = Cache() if cache is None else cache
        self._layers: LayerRenderer | None = LayerRenderer(self.cache)
        self._thread = threading.get_ident()

    def caustics(
        self,
        sea: Sea,
        sun_in_air: Floats,
        depths_m: Floats,
        time_s: float,
        settings: CausticSettings,
        refractive_index: float,
        spread: BeamSpread | None,
    ) -> CausticStack:
        """Return the caustics of `blurred_stack`."""
        from mr360uw.caustics.flux.blurred_stack import blurred_stack

        return blurred_stack(sea, sun_in_air, depths_m, time_s, settings, refractive_index, spread)

    def layer(self, shot: Shot, *, variables: bool = False) -> Steps[tuple[Layer, Aovs | None]]:
        """Return the layer of a shot, and its output variables if asked for, read back from the device. What needs the
        device is done on the thread that made the renderer.
        """
        if self._layers is None:  # released
            from mr360uw.composite.gl.layer_renderer import LayerRenderer

            self._layers = LayerRenderer(self.cache)
        return self._layers.steps(shot, variables=variables)

    def answer(self) -> None:
        """Take from the device what the steps under way wait for."""
        if self._layers is not None:
            self._layers.answer()

    def release(self) -> None:
        """Let go of all that is kept between frames, here and on the device; a later frame makes it anew.

        Asked for on another thread, it is the next frame on the renderer's thread that releases what is on the device.
        """
        from mr360uw.gl.context import release_unused

        self.cache.clear()
        self._layers = None
        if threading.get_ident() == self._thread:
            release_unused()


def close_backend(backend: Backend) -> None:
    """Let go of all that a backend and the scenes of this process keep; scenes still open make it anew."""
    backend.release()
    drop_shared()


def end_context() -> None:
    """Release the OpenGL context of this thread, and all that was made in it; for a thread that ends."""
    from mr360uw.gl.context import gl_context

    with suppress(GlError):  # of a thread that never had one, which would be made and released
        gl_context().release()


def check_backend(name: str) -> None:
    """Raise `ParameterError` for the name of a backend that there is not."""
    if name not in get_args(BackendName):
        names = ", ".join(get_args(BackendName))
        raise ParameterError(f"backend - is not known (got {name!r}) - take one of {names}")


def make_backend(name: BackendName | str = "auto", cache: Cache | None = None) -> tuple[Backend, str]:
    """Return a backend and, where the reference or the processor stands in for it, a line with the reason (else "").

    Before `auto` takes a graphics card for the first time, one small picture shows whether it draws right; before a
    card blends, by whatever name, another one shows whether it does that right. cache: that it is to have; None for an
    own one. Raises `GlError` if "gl" is asked for and OpenGL is not available, `ParameterError` for an unknown name.
    """
    check_backend(name)
    if name == "reference":
        return Reference(cache), ""
    try:
        found = Gl(cache)
    except GlError as error:
        if name == "gl":
            raise
        return Reference(cache), f"no OpenGL, so the reference renderer runs ({error})"
    if name == "auto":
        from mr360uw.composite.gl.self_test import doubt_of_device

        if doubt := doubt_of_device():
            return Reference(cache), f"{found.device} fails its first trial, so the reference renderer runs ({doubt})"
    return found, found.note
