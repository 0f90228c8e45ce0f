# SPDX-License-Identifier: Apache-2.0
"""Frame that is shown: its intermediate results, the scene it is of, and the renderer that made it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.shot import PlacedObject, Receiver
from mr360uw.ibl.lighting import turned
from mr360uw.render.backends import Backend
from mr360uw.render.frame import Frame
from mr360uw.render.loaded import Loaded
from mr360uw.types import Floats, Sun, View


@dataclass(frozen=True, slots=True, eq=False)
class ShownFrame:
    """A frame to be looked at. renderer: to be used in its own thread alone. duration_s: of the clip, 0 for a still.

    dark: whether the page around the picture is dark.
    """

    frame: Frame
    loaded: Loaded
    renderer: Backend
    duration_s: float = 0.0
    dark: bool = True

    @property
    def palette(self) -> Palette:
        """Colours of charts."""
        return DARK if self.dark else LIGHT

    @property
    def time_s(self) -> float:
        """Time of the frame [s]."""
        return self.frame.plate.time_s

    def view_of(self, width: int) -> View:
        """Return the camera's view with frames of another width."""
        return replace(self.loaded.view(self.time_s), width=width, height=width // 2)

    @property
    def receiver(self) -> Receiver | None:
        """The receiver as it is in this frame, or None."""
        return self.loaded.receiver_at(self.frame.plate.index, self.time_s)

    @property
    def sun(self) -> Sun | None:
        """The frame's sun in the world's axes, or None."""
        if self.frame.light is None:
            return None
        return turned(self.frame.light.environment, self.loaded.view(self.time_s).world_from_camera).sun

    @property
    def placed(self) -> tuple[PlacedObject, ...]:
        """The objects as they are at this time."""
        view, index = self.loaded.view(self.time_s), self.frame.plate.index
        return tuple(o.at(self.time_s, index, view.position, view.world_from_camera) for o in self.loaded.objects)

    @property
    def ground_y(self) -> tuple[float, str]:
        """Height [m] at which caustics are shown, and of what it is: the receiver, the lowest object or the camera."""
        receiver = self.receiver
        if receiver is not None and receiver.plane_y is not None:
            return receiver.plane_y, "receiver"
        if receiver is not None and receiver.mesh is not None:
            return float(np.mean(receiver.mesh[..., 1])), "receiver's mean height"
        if self.placed:
            return min(float(one.to_world(one.mesh.hull)[..., 1].min()) for one in self.placed), "lowest object"
        return float(self.loaded.view(self.time_s).position[1]), "camera"


# Text, scales and legends in pictures of the tuning page, readable on dark and on light pages.

Codes = NDArray[np.uint8]
"""A picture (H, W, 3), RGB."""
Color = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Palette:
    """Colours of a chart. strong: of the camera and the frame's own time. warm: of lights. series: of objects."""

    back: Color
    line: Color
    text: Color
    soft: Color
    strong: Color
    warm: Color
    series: tuple[Color, ...]


DARK = Palette(
    (20, 24, 29), (58, 68, 79), (230, 237, 243), (159, 176, 192), (56, 189, 248), (251, 191, 36),
    ((244, 114, 182), (74, 222, 128), (167, 139, 250), (251, 146, 60), (45, 212, 191)),
)  # fmt: skip
LIGHT = Palette(
    (255, 255, 255), (195, 204, 213), (22, 32, 42), (82, 96, 109), (11, 110, 153), (180, 83, 9),
    ((190, 24, 93), (21, 128, 61), (109, 40, 217), (194, 65, 12), (15, 118, 110)),
)  # fmt: skip
_BLACK, _WHITE = (0, 0, 0), (255, 255, 255)


def write(image: Codes, text: str, at: tuple[float, float], color: Color, size: float = 0.5) -> None:
    """Write text into a picture, its left end on the baseline at (x, y) [px]; size 0.5 is 11 pixels high."""
    import cv2

    words, place = text.encode("ascii", "replace").decode(), (round(at[0]), round(at[1]))
    cv2.putText(image, words, place, cv2.FONT_HERSHEY_SIMPLEX, size, color, 1, cv2.LINE_AA)


def text_width(text: str, size: float = 0.5) -> int:
    """Return how wide a text is [px]."""
    import cv2

    return int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0])


def label(image: Codes, text: str, at: tuple[float, float]) -> None:
    """Write white text on a dark ground, readable over any picture."""
    import cv2

    x, y = round(at[0]), round(at[1])
    part = image[max(y - 14, 0) : y + 6, max(x - 5, 0) : x + text_width(text) + 5]
    part[:] = cv2.addWeighted(part, 0.3, np.zeros_like(part), 0.7, 0.0)
    write(image, text, (x, y), _WHITE)


def round_length(most: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `most` (> 0)."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(f * power for f in (1.0, 2.0, 5.0) if f * power <= most * (1.0 + 1e-9)))


def scale_bar(image: Codes, metre_px: float, at: tuple[float, float], most_px: float) -> float:
    """Draw a bar of a round length, at most `most_px` long, left end at (x, y) [px]; return its length [m].

    metre_px: pixels to a metre.
    """
    import cv2

    length = round_length(most_px / metre_px)
    x, y = round(at[0]), round(at[1])
    end = x + round(length * metre_px)
    label(image, f"{length:g} m", (x, y - 10))
    cv2.rectangle(image, (x, y - 4), (end, y), _BLACK, -1)
    cv2.rectangle(image, (x + 1, y - 3), (end - 1, y - 1), _WHITE, -1)
    return length


def false_colour(values: Floats) -> Codes:
    """Return the colours (..., 3) of values in [0, 1], blue to red (OpenCV's Turbo)."""
    import cv2

    codes = np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)
    colours = cv2.applyColorMap(codes.reshape(-1, 1), cv2.COLORMAP_TURBO)[:, 0, ::-1]
    return np.ascontiguousarray(colours.reshape(*codes.shape, 3))


def legend(image: Codes, words: list[tuple[float, str]], at: tuple[int, int], width: int) -> None:
    """Draw the false colours from 0 to 1 with words below at their values; top left corner at (x, y) [px]."""
    (x, y), height = at, 14
    room = image[y - 8 : y + height + 26, x - 12 : x + width + 30]
    room[:] = (0.3 * room).astype(np.uint8)
    image[y : y + height, x : x + width] = false_colour(np.linspace(0.0, 1.0, width))
    for value, text in words:
        place = x + value * (width - 1)
        image[y + height : y + height + 4, int(place)] = _WHITE
        write(image, text, (place - 0.5 * text_width(text, 0.42), y + height + 18), _WHITE, 0.42)


def message(text: str, palette: Palette, width: int = 1024, height: int = 512) -> Codes:
    """Return a picture that says why there is none; long texts are broken into lines."""
    image = np.full((height, width, 3), palette.back, np.uint8)
    lines: list[str] = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if text_width(longer, 0.6) > 0.85 * width:
            lines.append(word)
        else:
            lines[-1] = longer
    for number, line in enumerate(lines):
        y = 0.5 * height + 28 * (number - 0.5 * (len(lines) - 1))
        write(image, line, (0.5 * (width - text_width(line, 0.6)), y), palette.soft, 0.6)
    return image
