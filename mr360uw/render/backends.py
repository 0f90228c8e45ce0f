# SPDX-License-Identifier: Apache-2.0
"""The two renderers behind one interface, and the choice between them.

`reference` is float64 NumPy and rays; it defines the right answer and needs no OpenGL. `gl` draws the same with
OpenGL 3.3.
"""

from __future__ import annotations

from typing import Any, Literal, Protocol

from mr360uw.cache import Cache
from mr360uw.caustics.settings import CausticSettings, Sea
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.shot import Shot
from mr360uw.errors import GlError, ParameterError
from mr360uw.types import CausticStack, Floats, Layer

BackendName = Literal["auto", "gl", "reference"]


class Backend(Protocol):
    """The stages that are drawn: caustics and the layer of objects."""

    name: str
    device: str

    def caustics(
        self,
        sea: Sea,
        sun_in_air: Floats,
        depths_m: Floats,
        time_s: float,
        settings: CausticSettings,
        refractive_index: float,
    ) -> Any:
        """Return the caustics on planes, in the form that this backend's `layer` reads."""

    def layer(self, shot: Shot, *, variables: bool = False) -> tuple[Layer, Aovs | None]:
        """Return what one frame's objects and receiver lay over its plate, and its output variables if asked for."""

    def download(self, stack: Any) -> CausticStack:
        """Return what `caustics` made as arrays."""


class Reference:
    """Float64 on the processor."""

    name = "reference"
    device = "processor, float64"

    def __init__(self) -> None:
        self.cache = Cache()

    def caustics(
        self,
        sea: Sea,
        sun_in_air: Floats,
        depths_m: Floats,
        time_s: float,
        settings: CausticSettings,
        refractive_index: float,
    ) -> CausticStack:
        """Return the caustics of `mr360uw.caustics.caustic_stack`."""
        from mr360uw.caustics import caustic_stack

        return caustic_stack(sea, sun_in_air, depths_m, time_s, settings, refractive_index)

    def layer(self, shot: Shot, *, variables: bool = False) -> tuple[Layer, Aovs | None]:
        """Return the layer of `mr360uw.composite.reference`."""
        from mr360uw.composite.reference import render_aovs, render_layer

        return render_aovs(shot, self.cache) if variables else (render_layer(shot, self.cache), None)

    def download(self, stack: CausticStack) -> CausticStack:
        """Return the stack itself."""
        return stack


class Gl:
    """OpenGL, on the thread that made this object. cache: what is kept between frames; it may be emptied at will."""

    name = "gl"

    def __init__(self) -> None:
        from mr360uw.caustics.gl.renderer import CausticRenderer
        from mr360uw.composite.gl.layer_renderer import LayerRenderer
        from mr360uw.gl.context import gl_device

        self.device = gl_device().renderer
        self.cache = Cache()
        self._caustics = CausticRenderer()
        self._layers = LayerRenderer(self.cache)

    def caustics(
        self,
        sea: Sea,
        sun_in_air: Floats,
        depths_m: Floats,
        time_s: float,
        settings: CausticSettings,
        refractive_index: float,
    ) -> Any:
        """Return the caustics as textures of the device."""
        return self._caustics.stack(sea, sun_in_air, depths_m, time_s, settings, refractive_index)

    def layer(self, shot: Shot, *, variables: bool = False) -> tuple[Layer, Aovs | None]:
        """Return the layer, and its output variables if asked for, drawn in tiles and read back."""
        return self._layers.render_aovs(shot) if variables else (self._layers.render(shot), None)

    def download(self, stack: Any) -> CausticStack:
        """Return textures as arrays."""
        downloaded: CausticStack = stack.download()
        return downloaded


def make_backend(name: BackendName | str = "auto") -> tuple[Backend, str]:
    """Return a backend and, where `auto` had to fall back, one line that says why (else "").

    Raises `GlError` where "gl" is asked for and cannot be had, `ParameterError` for another name.
    """
    if name == "reference":
        return Reference(), ""
    if name not in ("auto", "gl"):
        raise ParameterError(f"backend - is not known (got {name!r}) - take auto, gl or reference")
    try:
        return Gl(), ""
    except GlError as error:
        if name == "gl":
            raise
        return Reference(), f"no OpenGL, so the reference renderer runs ({error})"
