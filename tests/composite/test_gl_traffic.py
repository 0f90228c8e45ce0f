# SPDX-License-Identifier: Apache-2.0
"""What goes between the processor and the device: pixels on their way back, and what a moving frame waits for."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from typing import Any

import moderngl
import numpy as np
import pytest

from mr360uw.composite.gl.layer_renderer import LayerRenderer
from mr360uw.composite.gl.targets import Targets
from mr360uw.composite.shot import Receiver, Shot
from mr360uw.steps import Pause, Steps, finished, side_by_side
from mr360uw.threads import in_flight
from mr360uw.types import Rectangle
from tests.composite.scenes import box, medium, placed, shot, sphere

pytestmark = pytest.mark.usefixtures("gl")


def filled(targets: Targets, name: str, size: tuple[int, int], *values: float) -> moderngl.Framebuffer:
    target = targets.target(name, *size, (4,) * len(values))
    target.clear(*values[:1] * 4)
    for attachment, value in zip(target.color_attachments, values, strict=True):
        attachment.write(np.full((target.height, target.width, 4), value, np.float32))
    return target


def test_pixels_are_those_of_the_time_they_were_sent() -> None:
    targets = Targets()
    sent = []
    for value in (1.0, 2.0, 3.0):
        target = filled(targets, "one", (8, 4), value, 10.0 * value)
        sent.append(targets.send(target, Rectangle(2, 1, 5, 3)))
    for value, pixels in zip((1.0, 2.0, 3.0), sent, strict=True):
        first, second = pixels.images()
        assert first.shape == second.shape == (3, 5, 4)
        assert np.all(first == value)
        assert np.all(second == 10.0 * value)


def test_a_target_has_the_channels_that_are_asked_for() -> None:
    """Scenes drawn one after the other ask for other outputs; those of the last one must not be read as these."""
    targets = Targets()
    one, four = (targets.target("same name", 8, 4, (channels,)) for channels in (1, 4))
    assert [texture.components for target in (one, four) for texture in target.color_attachments] == [1, 4]
    assert targets.target("same name", 8, 4, (1,)) is one


def test_more_than_fits_is_read_too() -> None:
    targets, size = Targets(), (256, 96)
    sent = [
        targets.send(filled(targets, "one", size, float(k)), Rectangle(0, 0, *size)) for k in range(9)
    ]  # 384 KiB each
    assert [float(pixels.images()[0].max()) for pixels in sent] == list(range(9))
    assert [float(pixels.images()[0].min()) for pixels in sent] == list(range(9))


def test_steps_side_by_side_ask_before_one_of_them_waits() -> None:
    order: list[str] = []

    def steps(name: str, *pauses: Pause) -> Steps[str]:
        for k, pause in enumerate(pauses):
            order.append(f"{name}{k}")
            yield pause
        return name.upper()

    device, answer, rest = Pause
    parts = side_by_side(steps("a", device, answer, device, answer), steps("b"), steps("c", answer, rest))
    results: list[str] = []

    def whole() -> Steps[None]:
        results.extend((yield from parts))

    seen = list(whole())
    assert results == ["A", "B", "C"]
    assert seen == [device, answer, device, answer, rest]
    assert order == ["a0", "c0", "a1", "a2", "c1", "a3"]
    assert finished(steps("d", device, rest)) == "D"


BALL, CUBE = sphere(), box((0.6, 0.5, 0.4))


def moving(k: int) -> Shot:
    return shot(
        placed(BALL, (0.4 + 0.01 * k, -0.6, -1.8)), placed(CUBE, (-0.6, -0.9, -1.6), (25, 3 * k, 0)), width=512,
        medium=medium(), receiver=Receiver(plane_y=-1.2), camera_position=np.array([0.0, 0.002 * k, 0.0]),
    )  # fmt: skip


def count_calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Return a count of what is made and of reads that wait, from now on."""
    calls: Counter[str] = Counter()

    def counted(owner: type, name: str, what: str) -> None:
        inner: Callable[..., Any] = getattr(owner, name)

        def method(*given: Any, **named: Any) -> Any:
            calls[what] += 1
            return inner(*given, **named)

        monkeypatch.setattr(owner, name, method)

    for name in ("texture", "texture_array", "framebuffer", "buffer"):
        counted(moderngl.Context, name, "made")
    for name in ("read", "read_into"):
        counted(moderngl.Buffer, name, "read")
    counted(moderngl.Framebuffer, "read", "read")
    counted(moderngl.Texture, "read", "read")
    return calls


def test_a_moving_frame_makes_no_texture_and_waits_four_times(monkeypatch: pytest.MonkeyPatch) -> None:
    renderer = LayerRenderer()
    for k in range(6):
        assert renderer.render(moving(k)).alpha.max() > 0.9
    calls = count_calls(monkeypatch)
    for k in range(6, 9):
        renderer.render(moving(k))
    assert calls == {"read": 3 * 4}


def test_moving_frames_under_way_together_wait_once_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bits are those of frames that are drawn alone, and other threads make no OpenGL context."""
    here = threading.current_thread()
    make: Callable[..., moderngl.Context] = moderngl.create_context

    def made_here(*given: Any, **named: Any) -> moderngl.Context:
        assert threading.current_thread() is here
        return make(*given, **named)

    monkeypatch.setattr(moderngl, "create_context", made_here)
    alone, together = LayerRenderer(), LayerRenderer()
    flight = in_flight((together.steps(moving(k)) for k in range(18)), together.answer, 5)
    calls = Counter[str]()
    for k, (layer, variables) in enumerate(flight):
        if k == 8:
            calls = count_calls(monkeypatch)
        if k == 12:
            assert calls == {"read": 4}
        if k in (0, 3, 17):
            expected = alone.render(moving(k))
            assert variables is None
            assert len(layer.tiles) == len(expected.tiles)
            for one, other in zip(layer.tiles, expected.tiles, strict=True):
                for name in ("radiance", "alpha", "distance_m", "ratio"):
                    np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
