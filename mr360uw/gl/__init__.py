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
from collections.abc import Callable, Mapping
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


def _compile(sources: dict[str, Source]) -> moderngl.Program:
    import moderngl

    texts: dict[str, Any] = {stage: source.text for stage, source in sources.items()}
    try:
        return gl_context().program(**texts)
    except moderngl.Error as error:
        log = str(error)
        # compilers and linkers name the stage ("fragment_shader", "Fragment info"); lines belong to that stage's files
        failed = next((stage for stage in sources if stage.partition("_")[0] in log.lower()), None)
        log = sources[failed].explain(log) if failed else log
        raise GlError(f"shader - does not compile - {log.strip()}") from error


def program(*, fragment: str, defines: Mapping[str, str | int | float] | None = None) -> moderngl.Program:
    """Return a linked program of a shader file below the package, whose one triangle fills the target.

    It hands `uv` in [0, 1]^2 to the fragment shader and is drawn with `draw_fullscreen`.
    """
    first = expand_source(_FULLSCREEN, "fullscreen.vert")
    return _compile({"vertex_shader": first, "fragment_shader": load_source(fragment, defines)})


def program_from_text(*, fragment: str, name: str = "shader") -> moderngl.Program:
    """Return a linked full-screen program of fragment shader text, for harnesses that wrap a function of a file."""
    whole = expand_source(_FULLSCREEN, "fullscreen.vert")
    return _compile({"vertex_shader": whole, "fragment_shader": expand_source(fragment, name)})


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


@per_thread
def largest_texture() -> int:
    """Return the most texels of a texture along one side."""
    return int(gl_context().info["GL_MAX_TEXTURE_SIZE"])


def texture_array_from_array(array: ArrayLike) -> moderngl.TextureArray:
    """Return an unfiltered float texture array of images (N, H, W, C)."""
    import moderngl

    images = np.ascontiguousarray(array, dtype=np.float32)
    count, height, width, channels = images.shape
    texture = gl_context().texture_array((width, height, count), channels, dtype="f4")
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    texture.write(images, alignment=1)
    return texture


VERSION = "#version 330 core"
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


@dataclass(frozen=True, slots=True)
class Source:
    """One shader stage ready for the compiler, and the files that its line numbers encode."""

    text: str
    files: tuple[str, ...]

    def explain(self, log: str) -> str:
        """Return a compiler log with its encoded line numbers replaced by file:line."""

        def name(match: re.Match[str]) -> str:
            number = int(match.group(2))
            index, line = divmod(number, _LINES_PER_FILE)
            return f"{self.files[index]}:{line}" if index < len(self.files) else match.group(0)

        # Mesa: 0:30012(5): error ...    NVIDIA: 0(30012) : error ...    Apple and AMD: ERROR: 0:30012: ...
        log = re.sub(r"\b(0):(\d{5,})(?:\(\d+\))?", name, log)
        return re.sub(r"\b(0)\((\d{5,})\)", name, log)


def load_source(name: str, defines: Mapping[str, str | int | float] | None = None) -> Source:
    """Return the shader file `name` (below the package folder) with includes expanded and `defines` set."""
    path = _ROOT / name
    if not path.is_file():
        raise GlError(f"{name} - no such shader - check the name")
    return expand_source(path.read_text("utf-8"), name, defines)


def expand_source(text: str, name: str, defines: Mapping[str, str | int | float] | None = None) -> Source:
    """Return shader text with includes expanded; `name` is its path in messages and for relative includes."""
    files = ["constants.glsl"]
    out = [VERSION]
    for key, value in sorted((defines or {}).items()):  # in a fixed order, for the drivers' caches
        out.append(f"#define {key} {value if isinstance(value, str) else glsl_number(value)}")
    out += ["#line 1", constants_source()]
    _expand(text, name, files, out)
    return Source("\n".join(out) + "\n", tuple(files))


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
