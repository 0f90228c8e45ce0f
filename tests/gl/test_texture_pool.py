# SPDX-License-Identifier: Apache-2.0
"""Textures and buffers that are lent by a context's pool, and go back to it."""

from __future__ import annotations

import gc

import numpy as np
import pytest

from mr360uw.gl.context import gl_context, next_frame, texture_from_array, texture_pool
from mr360uw.gl.texture_pool import TexturePool, roomy

pytestmark = pytest.mark.usefixtures("gl")


@pytest.fixture
def pool() -> TexturePool:
    return TexturePool(gl_context())


def test_what_is_no_longer_used_is_lent_again_in_the_next_frame(pool: TexturePool) -> None:
    first, kept = pool.texture((4, 3), 2), pool.texture((4, 3), 2)
    number = first.glo
    del first
    assert pool.texture((4, 3), 2).glo not in (number, kept.glo), "the device may still read it in this frame"
    pool.next_frame()
    again = [pool.texture((4, 3), 2) for _ in range(2)]
    assert number in [texture.glo for texture in again]
    assert kept.glo not in [texture.glo for texture in again]


def test_only_the_same_size_and_format_is_lent_again(pool: TexturePool) -> None:
    number = pool.texture((4, 3), 2).glo
    pool.next_frame()
    others = [pool.texture((3, 4), 2), pool.texture((4, 3), 4), pool.texture((4, 3), 2, "f2")]
    assert number not in [texture.glo for texture in others]
    assert pool.texture((4, 3), 2).glo == number


def test_buffers_and_arrays_are_lent_too(pool: TexturePool) -> None:
    numbers = pool.buffer(64).glo, pool.texture_array((4, 3, 2), 1).glo
    pool.next_frame()
    buffer, array = pool.buffer(64), pool.texture_array((4, 3, 2), 1)
    assert (buffer.glo, array.glo) == numbers
    buffer.write(bytes(range(64)))
    assert buffer.read() == bytes(range(64))


def test_what_nobody_asks_for_is_let_go_of(pool: TexturePool) -> None:
    pool.texture((4, 3), 2)
    context = gl_context()
    context.gc()
    for _ in range(10):
        pool.next_frame()
    assert context.gc() == 1


def test_the_garbage_collector_ends_nothing_that_is_lent(pool: TexturePool) -> None:
    ring = [pool.texture((2, 2), 4)]
    number = ring[0].glo
    ring.append(ring)  # type: ignore[arg-type]
    del ring
    gc.collect()
    pool.next_frame()
    gl_context().gc()
    again = pool.texture((2, 2), 4)
    assert again.glo == number
    again.write(np.arange(16, dtype=np.float32))
    assert np.array_equal(np.frombuffer(again.read(), np.float32), np.arange(16))


def test_a_texture_keeps_its_framebuffer(pool: TexturePool) -> None:
    texture = pool.texture((2, 2), 4)
    target = pool.framebuffer(texture)
    assert pool.framebuffer(texture) is target
    target.clear(1.0, 2.0, 3.0, 4.0)
    assert np.array_equal(np.frombuffer(texture.read(), np.float32), np.tile([1.0, 2.0, 3.0, 4.0], 4))


def test_images_that_are_listed_have_few_sizes(rng: np.random.Generator) -> None:
    images = [rng.uniform(size=(rows, 5, 3)).astype(np.float32) for rows in (9, 11, 12)]
    textures = [texture_from_array(image, listed=True) for image in images]
    assert {texture.size for texture in textures} == {(5, 12)}
    for image, texture in zip(images, textures, strict=True):
        read = np.frombuffer(texture.read(alignment=1), np.float32).reshape(12, 5, 3)
        assert np.array_equal(read[: len(image)], image)


def test_every_thread_has_one_pool() -> None:
    number = texture_from_array(np.zeros((7, 3))).glo
    next_frame()
    assert texture_pool().texture((3, 7), 1).glo == number


def test_rooms_are_at_most_half_too_large() -> None:
    assert [roomy(count, 100) for count in (1, 3, 4, 5, 6, 7, 9, 65, 97, 100)] == [
        4, 4, 4, 6, 6, 8, 12, 96, 100, 100,
    ]  # fmt: skip
