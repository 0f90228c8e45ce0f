# SPDX-License-Identifier: Apache-2.0
"""Options of `mr360uw new` about the place of its mesh, as one wish."""

from __future__ import annotations

from mr360uw.errors import ParameterError
from mr360uw.first_look.place_in_plate import Wish


def wish_of(at: str | None, stand: bool, swim: bool, size_m: float | None) -> Wish:
    """Return the wish that --at, --stand, --swim and --size state; raise `ParameterError` where they state none."""
    if stand and swim:
        raise ParameterError("--stand, --swim - exclude each other (got both) - give one of them")
    direction = None
    if at is not None:
        try:
            azimuth, elevation = (float(part) for part in at.split(","))
        except ValueError:
            raise ParameterError(
                f"--at - is no direction (got {at!r}) - write azimuth,elevation in degrees, as in 30,-25"
            ) from None
        direction = azimuth, elevation
    return Wish(direction, "stands" if stand else "swims" if swim else None, size_m)
