# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base import constants
from mr360uw.errors import GlError
from mr360uw.gl import constants_source, expand_source, glsl_number, program_from_text
from tests.glsl import glsl_call


def test_numbers_cross_exactly(rng: np.random.Generator) -> None:
    for value in [*(10.0 ** rng.uniform(-30, 30, 200)), 5.802e-06, 1.0, 0.0, -2.5]:
        assert np.float32(glsl_number(float(value))) == np.float32(value)
        assert any(c in glsl_number(float(value)) for c in ".e")
    assert glsl_number(3) == "3"


def test_every_constant_reaches_the_shaders() -> None:
    text = constants_source()
    for name in vars(constants):
        if name.isupper():
            assert f" {name} = " in text


def test_a_file_is_included_once_and_from_the_package_or_beside() -> None:
    text = expand_source('#include "medium/lookup.glsl"\n#include "medium/lookup.glsl"\n', "a.frag")[0]
    assert text.count("struct MediumTable") == 1
    assert "direction_from_frame" in expand_source('#include "ibl/lookup.glsl"\n', "a.frag")[0]


def test_an_include_in_a_comment_is_text() -> None:
    expand_source('// #include "nowhere.glsl"\n', "a.frag")


def test_a_missing_include_is_named() -> None:
    with pytest.raises(GlError, match=r"a\.frag:2.*nowhere\.glsl"):
        expand_source('// one\n#include "nowhere.glsl"\n', "a.frag")


@pytest.mark.usefixtures("gl")
def test_a_compile_error_names_file_and_line() -> None:
    with pytest.raises(GlError, match=r"broken\.frag:4"):
        program_from_text(
            name="broken.frag",
            fragment='#include "base/sphere.glsl"\nout vec4 c;\nvoid main() {\n    c = nonsense;\n}\n',
        )


@pytest.mark.usefixtures("gl")
def test_a_constant_has_its_float32_value_on_the_device() -> None:
    got = glsl_call("base/sphere.glsl", "SUN_HALF_ANGLE_RAD + 0.0 * x", x=np.zeros(3))
    assert np.all(got == np.float32(constants.SUN_HALF_ANGLE_RAD))
