# SPDX-License-Identifier: Apache-2.0
"""Run one GLSL expression on columns of numbers, to compare a shader function with its Python twin."""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.errors import GlError
from mr360uw.gl import (
    draw_fullscreen,
    gl_context,
    program_from_text,
    set_uniforms,
    texture_from_array,
)

_TYPES = {1: "float", 2: "vec2", 3: "vec3", 4: "vec4"}
_WIDTH = 256


def gl_available() -> bool:
    """Return whether a context can be made here."""
    try:
        gl_context()
    except GlError:
        return False
    return True


def glsl_call(
    file: str,
    expression: str,
    result: int = 1,
    declarations: str = "",
    textures: dict[str, Any] | None = None,
    uniforms: dict[str, Any] | None = None,
    **columns: np.ndarray,
) -> np.ndarray:
    """Return `expression` evaluated in float32 for every row of `columns` (n,) or (n, k <= 4), as (n,) or (n, result).

    The expression may name the columns, every function of the shader `file` (below the package) and what
    `declarations` declares; `textures` and `uniforms` (a double underscore stands for a dot) give those their values.
    """
    count = len(next(iter(columns.values())))
    height = -(-count // _WIDTH)
    fetches, bound = [], dict(textures or {})
    for name, column in columns.items():
        values = np.asarray(column, np.float32).reshape(count, -1)
        texels = np.zeros((height * _WIDTH, 4), np.float32)
        texels[:count, : values.shape[1]] = values
        bound[f"column_{name}"] = texture_from_array(texels.reshape(height, _WIDTH, 4))
        swizzle = "xyzw"[: values.shape[1]]
        fetches.append(f"{_TYPES[values.shape[1]]} {name} = texelFetch(column_{name}, place, 0).{swizzle};")
    samplers = "".join(f"uniform sampler2D column_{name};\n" for name in columns)
    padding = ", 0.0" * (4 - result)
    shader = program_from_text(
        name=f"call of {file}",
        fragment=f'#include "{file}"\n{declarations}\n{samplers}out vec4 result_value;\nvoid main() {{\n'
        f"ivec2 place = ivec2(gl_FragCoord.xy);\n{chr(10).join(fetches)}\n"
        f"result_value = vec4({expression}{padding});\n}}\n",
    )
    for unit, (name, texture) in enumerate(bound.items()):
        texture.use(unit)
        set_uniforms(shader, **{name: unit})
    set_uniforms(shader, **(uniforms or {}))
    context = gl_context()
    target = context.framebuffer([context.texture((_WIDTH, height), 4, dtype="f4")])
    draw_fullscreen(target, shader)
    texels = np.frombuffer(target.read(components=4, dtype="f4", alignment=1), np.float32)
    data = texels.reshape(-1, 4)[:count, :result]
    return data[:, 0] if result == 1 else data
