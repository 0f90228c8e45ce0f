# SPDX-License-Identifier: Apache-2.0
"""The two renderers behind one interface, and the choice between them.

`reference` casts rays in float64 NumPy, defines the right answer and needs no OpenGL. `gl` computes the same with
OpenGL 3.3.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal, get_args

from mr360uw.base.cache import Cache, drop_shared
from mr360uw.caustics.settings import CausticSettings, Sea
from mr360uw.composite.aovs import Aovs
from mr360uw.composite.shot import Shot
from mr360uw.errors import GlError, ParameterError
from mr360uw.types import BeamSpread, CausticStack, Floats, Layer

if TYPE_CHECKING:
    from mr360uw.composite.gl.layer_renderer import LayerRenderer
    from mr360uw.composite.receiver.blocks import Prepared

BackendName = Literal["auto", "gl", "reference"]
CausticsOf = Callable[[Sea, Floats, Floats, float, CausticSettings, float, BeamSpread | None], CausticStack]
"""Caustics of a sea under the direction of a sun in air (3,), on planes at depths (n,) [m], at a time [s]; with the
refractive index of the water, and the spread of the beam that it turns by small angles."""


class Reference:
    """The reference renderer: float64 on the processor."""

    name = "reference"
    device = "processor, float64"

    def __init__(self, cache: Cache | None = None) -> None:
        self.cache = Cache() if cache is None else cache

    @property
    def caustics(self) -> CausticsOf:
        """`mr360uw.caustics.caustic_stack`."""
        from mr360uw.caustics import caustic_stack

        return caustic_stack

    def prepare(self, shot: Shot, cache: Cache) -> Prepared | None:
        """Return nothing: every pixel is found by itself."""

    def layer(
        self,
        shot: Shot,
        prepared: Prepared | None = None,  # noqa: ARG002 - as `Gl` has it
        *,
        variables: bool = False,
    ) -> tuple[Layer, Aovs | None]:
        """Return the layer of `mr360uw.composite.reference`."""
        from mr360uw.composite.reference import render_aovs, render_layer

        return render_aovs(shot, self.cache) if variables else (render_layer(shot, self.cache), None)

    def release(self) -> None:
        """Empty the cache."""
        self.cache.clear()


class Gl:
    """The OpenGL renderer, for the thread that made it."""

    name = "gl"

    def __init__(self, cache: Cache | None = None) -> None:
        from mr360uw.composite.gl.layer_renderer import LayerRenderer
        from mr360uw.gl import gl_device

        self.device = gl_device().renderer
        self.cache = Cache() if cache is None else cache
        self._layers: LayerRenderer | None = LayerRenderer(self.cache)
        self._thread = threading.get_ident()

    @property
    def caustics(self) -> CausticsOf:
        """`summed_stack`."""
        from mr360uw.caustics.summed_stack import summed_stack

        return summed_stack

    def prepare(self, shot: Shot, cache: Cache) -> Prepared | None:
        """Return the ambient light of a shot's bodies, and the receiver that they may change."""
        from mr360uw.composite.receiver.blocks import prepare

        return prepare(shot, cache)

    def layer(
        self, shot: Shot, prepared: Prepared | None = None, *, variables: bool = False
    ) -> tuple[Layer, Aovs | None]:
        """Return the layer of a shot, and its output variables if asked for, read back from the device."""
        if self._layers is None:  # released
            from mr360uw.composite.gl.layer_renderer import LayerRenderer

            self._layers = LayerRenderer(self.cache)
        return self._layers.layer(shot, prepared, variables=variables)

    def release(self) -> None:
        """Let go of all that is kept between frames, here and on the device; a later frame makes it anew.

        Asked for on another thread, it is the next frame on the renderer's thread that releases what is on the device.
        """
        from mr360uw.gl import release_unused

        self.cache.clear()
        self._layers = None
        if threading.get_ident() == self._thread:
            release_unused()


Backend = Reference | Gl
"""The stages that a renderer computes: caustics, and the layer of objects with its output variables.

`prepare` finds on any thread what of a shot's layer can be found there, None for nothing, with a cache of that thread;
`layer` takes it, and finds it itself without. `cache` holds values between frames; it may be emptied. `release` lets go
of all that is kept, here and on the device; a later frame makes it anew.
"""


def close_backend(backend: Backend) -> None:
    """Let go of all that a backend and the scenes of this process keep; scenes still open make it anew."""
    backend.release()
    drop_shared()


def check_backend(name: str) -> None:
    """Raise `ParameterError` for the name of a backend that there is not."""
    if name not in get_args(BackendName):
        names = ", ".join(get_args(BackendName))
        raise ParameterError(f"backend - is not known (got {name!r}) - take one of {names}")


def make_backend(name: BackendName | str = "auto", cache: Cache | None = None) -> tuple[Backend, str]:
    """Return a backend and, where the reference or the processor stands in for it, a line with the reason (else "").

    Before `auto` takes a graphics card for the first time, one small picture shows whether it draws right. cache: that
    it is to have; None for an own one. Raises `GlError` if "gl" is asked for and OpenGL is not available,
    `ParameterError` for an unknown name.
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
    return found, ""
