# SPDX-License-Identifier: Apache-2.0
"""Contexts belong to threads."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

from mr360uw.gl import gl_context, per_thread, texture_from_array
from tests.glsl import gl_available


@pytest.mark.skipif(not gl_available(), reason="no OpenGL 3.3 here")
def test_threads_one_after_another_have_contexts_of_their_own() -> None:
    # a system gives the number of a thread that has ended to the next one
    seen: list[Any] = []

    def draw() -> None:
        image = np.full((2, 3, 4), len(seen), np.float32)
        seen.append((gl_context(), np.frombuffer(texture_from_array(image).read(), np.float32)))

    for _ in range(3):
        thread = threading.Thread(target=draw)
        thread.start()
        thread.join()
    assert [values[0] for _, values in seen] == [0.0, 1.0, 2.0]
    assert len({id(context) for context, _ in seen}) == 3


def test_each_thread_makes_its_own_once() -> None:
    @per_thread
    def thing() -> object:
        return object()

    found: list[object] = [thing(), thing()]
    thread = threading.Thread(target=lambda: found.append(thing()))
    thread.start()
    thread.join()
    assert found[0] is found[1]
    assert found[2] is not found[0]
