# SPDX-License-Identifier: Apache-2.0
"""OpenGL contexts, one for each thread; shader sources, programs and textures on them.

Every shader runs on OpenGL 3.3 core. On Linux the context comes headless from EGL, on a GPU or on Mesa's llvmpipe;
elsewhere from the window system. Objects of a context are used on the thread that made it.

`#include "medium/lookup.glsl"` takes a path below the package folder, or beside the including file, once per program.
`constants.glsl`, generated from `base.constants`, is prepended to every shader. Line markers encode the file in the
number (`#line 30012` = file 3, line 12), because Mesa always prints source 0.
"""

from __future__ import annotations

import functools
import re
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from mr360uw.base import constants
from mr360uw.errors import GlError

if TYPE_CHECKING:
    import moderngl

T = TypeVar("T")

_FULLSCREEN = """
out vec2 uv;
void main() {
    uv = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2);
    gl_Position = vec4(uv * 2.0 - 1.0, 0.0, 1.0);
}
"""


@dataclass(frozen=True, slots=True)
class GlDevice:
    """Names of the driver behind a context. software: whether it renders on the processor."""

    renderer: str
    vendor: str
    version: str
    software: bool


def per_thread(make: Callable[[], T]) -> Callable[[], T]:
    """Return a function that calls `make` once in every thread: a context and its objects belong to one thread."""
    kept = threading.local()

    @functools.wraps(make)
    def get() -> T:
        if not hasattr(kept, "value"):
            kept.value = make()
        value: T = kept.value
        return value

    return get


@per_thread
def gl_context() -> moderngl.Context:
    """Return this thread's context, made at the first call; raise `GlError` where there is no OpenGL 3.3."""
    try:
        import moderngl

        settings: dict[str, Any] = {"backend": "egl"} if sys.platform.startswith("linux") else {}
        context = moderngl.create_context(standalone=True, require=330, **settings)
    except Exception as error:  # the drivers' own exceptions have no common base
        raise GlError(
            f"OpenGL - no 3.3 core context can be made (got: {error}) - "
            "install a driver or Mesa's libEGL, or use backend='reference'"
        ) from error
    context.gc_mode = "context_gc"
    return context


def release_unused() -> None:
    """Release all objects of this thread's context that nothing refers to; between two frames."""
    gl_context().fbo = None  # type: ignore[assignment]  # the last one drawn into
    gl_context().gc()


def gl_device() -> GlDevice:
    """Return the driver's own names."""
    info = gl_context().info
    renderer = str(info["GL_RENDERER"])
    software = any(name in renderer.lower() for name in ("llvmpipe", "softpipe", "swiftshader", "software"))
    return GlDevice(renderer, str(info["GL_VENDOR"]), str(info["GL_VERSION"]), software)


def program(*, fragment: str, defines: Mapping[str, int] | None = None) -> moderngl.Program:
    """Return the program of a shader file below the package folder, see `program_from_text`."""
    path = _ROOT / fragment
    if not path.is_file():
        raise GlError(f"{fragment} - no such shader - check the name")
    return program_from_text(fragment=path.read_text("utf-8"), name=fragment, defines=defines)


def program_from_text(
    *, fragment: str, name: str = "shader", defines: Mapping[str, int] | None = None
) -> moderngl.Program:
    """Return a linked program of fragment shader text, whose one triangle fills the target.

    It hands `uv` in [0, 1]^2 to the fragment shader and is drawn with `draw_fullscreen`. name: of the shader in
    messages. Raises `GlError` for text that does not compile.
    """
    import moderngl

    vertex, _ = expand_source(_FULLSCREEN, "fullscreen.vert")
    text, files = expand_source(fragment, name, defines)
    try:
        return gl_context().program(vertex_shader=vertex, fragment_shader=text)
    except moderngl.Error as error:
        raise GlError(f"shader - does not compile - {_with_places(str(error), files).strip()}") from error


def _with_places(log: str, files: Sequence[str]) -> str:
    """Return a compiler log with its encoded line numbers replaced by file:line."""

    def place(match: re.Match[str]) -> str:
        index, line = divmod(int(match.group(1)), _LINES_PER_FILE)
        return f"{files[index]}:{line}" if index < len(files) else match.group(0)

    # Mesa: 0:30012(5): error ...    NVIDIA: 0(30012) : error ...    Apple and AMD: ERROR: 0:30012: ...
    log = re.sub(r"\b0:(\d{5,})(?:\(\d+\))?", place, log)
    return re.sub(r"\b0\((\d{5,})\)", place, log)


def draw_fullscreen(target: moderngl.Framebuffer, program: moderngl.Program) -> None:
    """Run `program`'s fragment shader once for every pixel of `target`."""
    target.use()
    gl_context().vertex_array(program, []).render(vertices=3)  # freed by Context.gc, which takes no released object


def set_uniforms(program: moderngl.Program, **values: Any) -> None:
    """Set uniforms by name (a double underscore stands for a dot); names, and ends of lists of numbers, that the
    compiler removed are ignored.
    """
    for name, value in values.items():
        uniform: Any = program.get(name.replace("__", "."), None)
        if uniform is not None:
            known = uniform.array_length * uniform.dimension
            uniform.value = tuple(np.ravel(value)[:known].tolist()) if np.ndim(value) else value


def texture_from_array(array: ArrayLike, dtype: str = "f4") -> moderngl.Texture:
    """Return an unfiltered texture of an image (H, W), (H, W, C); row 0 is texel row 0."""
    import moderngl

    image = np.ascontiguousarray(array, dtype={"f4": np.float32, "f2": np.float16, "f1": np.uint8}[dtype])
    (height, width), channels = image.shape[:2], image.shape[2] if image.ndim == 3 else 1
    texture = gl_context().texture((width, height), channels, image, alignment=1, dtype=dtype)
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture


def texture_array_from_array(array: ArrayLike) -> moderngl.TextureArray:
    """Return an unfiltered float texture array of images (N, H, W, C)."""
    import moderngl

    images = np.ascontiguousarray(array, dtype=np.float32)
    count, height, width, channels = images.shape
    texture = gl_context().texture_array((width, height, count), channels, dtype="f4")
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    texture.write(images, alignment=1)
    return texture


_VERSION = "#version 330 core"
_ROOT = Path(__file__).resolve().parent.parent
_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*(?://.*)?$')
_LINES_PER_FILE = 10_000


def glsl_number(value: float) -> str:
    """Return a GLSL literal that reads back as exactly float32(value)."""
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    text = repr(float(np.float32(value)))
    return text if any(c in text for c in ".en") else text + ".0"


@functools.cache
def constants_source() -> str:
    """Return `mr360uw.base.constants` as GLSL."""
    return "\n".join(
        f"const {'int' if isinstance(value, int) else 'float'} {name} = {glsl_number(value)};"
        for name, value in sorted(vars(constants).items())
        if name.isupper() and isinstance(value, int | float)
    )


def expand_source(text: str, name: str, defines: Mapping[str, int] | None = None) -> tuple[str, list[str]]:
    """Return shader text with includes expanded, ready for the compiler, and the files that its line numbers encode.

    name: its path in messages and for relative includes.
    """
    files, out = ["constants.glsl"], [_VERSION]
    out += [
        f"#define {key} {value}" for key, value in sorted((defines or {}).items())
    ]  # in one order, for the drivers' caches
    out += ["#line 1", constants_source()]
    _expand(text, name, files, out)
    return "\n".join(out) + "\n", files


def _expand(text: str, name: str, files: list[str], out: list[str]) -> None:
    """Append a file's name to `files` and its lines to `out`, with those files included that are not there yet."""
    index = len(files)
    files.append(name)
    out.append(f"#line {index * _LINES_PER_FILE + 1}")
    for number, line in enumerate(text.splitlines(), 1):
        match = _INCLUDE.match(line)
        if not match:
            out.append(line)
            continue
        wanted = match.group(1)
        candidates = [wanted, str(Path(name).parent / wanted)]
        found = next((c for c in candidates if c in files or (_ROOT / c).is_file()), None)
        if found is None:
            raise GlError(f'{name}:{number} - cannot find include (got "{wanted}") - give a path below mr360uw/')
        if found not in files:
            _expand((_ROOT / found).read_text("utf-8"), found, files, out)
        out.append(f"#line {index * _LINES_PER_FILE + number + 1}")
