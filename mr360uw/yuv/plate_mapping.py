# SPDX-License-Identifier: Apache-2.0
"""The interface of maps between a plate's R'G'B' values and light that a curve and primaries cannot say."""

from __future__ import annotations

from typing import Any, Literal, Protocol

from numpy.typing import NDArray

Levels = Literal["video", "data"]
"""What 0 and 1 of a map's input are. video: black and white of the plate's range. data: code 0 and full scale."""


class PlateMapping(Protocol):
    """A map between a plate's R'G'B' values and light that a curve and primaries cannot say: a lookup table, or OCIO.

    Implementations compare and hash by what the map does. on_file_codes: values are codes over full scale; otherwise
    0 is black and 1 is white of the plate's range. Both methods take and return (..., 3) floats, of any shape before.
    """

    @property
    def on_file_codes(self) -> bool:
        """Whether values are codes over full scale, rather than signals from black to white."""
        ...

    def to_light(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the linear Rec.709 light of values."""
        ...

    def to_values(self, light: NDArray[Any]) -> NDArray[Any]:
        """Return the values of linear Rec.709 light, the inverse of `to_light`."""
        ...
