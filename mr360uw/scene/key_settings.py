# SPDX-License-Identifier: Apache-2.0
"""Values of one parameter over time: the `[[keys]]` tables of a scene."""

from __future__ import annotations

import functools
import itertools
from typing import Any, Literal

import numpy as np
from pydantic import ValidationInfo, field_validator

from mr360uw.parameters import FULL_TURN_DEG, Parameters
from mr360uw.parameters import parameter as declared  # a field has its name
from mr360uw.types import Floats

Value = float | tuple[float, ...]
"""A number, or a vector of numbers."""


class KeyedParameter(Parameters):
    """One parameter that changes over time; before the first and after the last key it stays."""

    parameter: str = declared(..., "its name, as --set has it: sea.wind_speed, object.0.position_m.1")
    time_s: tuple[float, ...] = declared(..., "times of the keys from the start of the clip, ascending", unit="s")
    value: tuple[Value, ...] = declared(
        ..., "its value at each of these times: a number, or a list of numbers for a vector"
    )
    interpolation: Literal["linear", "smooth", "hold"] = declared(
        "smooth", "between keys: straight, a monotone cubic, or the value of the key before"
    )

    @field_validator("time_s")
    @classmethod
    def _ascending(cls, times: tuple[float, ...]) -> tuple[float, ...]:
        if not times:
            raise ValueError("is empty (got []) - give the time of one key at least")
        for one, after in itertools.pairwise(times):
            if after <= one:
                raise ValueError(f"must ascend (got {one:g}, then {after:g}) - sort the keys, one for each time")
        return times

    @field_validator("value")
    @classmethod
    def _one_for_each_time(cls, values: tuple[Value, ...], info: ValidationInfo) -> tuple[Value, ...]:
        times = info.data.get("time_s", values)
        if len(values) != len(times):
            raise ValueError(
                f"must have an entry for each time (got {len(values)} for {len(times)}) - add or remove entries"
            )
        if () in values:
            raise ValueError("has an empty list for a value (got []) - give a number, or the numbers of a vector")
        if len({np.shape(value) for value in values}) > 1:
            raise ValueError("must be all numbers or all vectors of one length (got both) - write them alike")
        return values

    def at(self, time_s: float, *, turns: bool = False) -> Value:
        """Return the value at a time [s]. turns: it is an angle [deg] that goes the shorter way round."""
        times, values = self.time_s, self.value
        if time_s <= times[0] or len(times) == 1:
            return values[0]
        if time_s >= times[-1]:
            return values[-1]
        if self.interpolation == "hold":
            return values[int(np.searchsorted(times, time_s, side="right")) - 1]
        found = _curve(self, turns)(time_s)
        return tuple(found.tolist()) if np.ndim(found) else float(found)


@functools.lru_cache(maxsize=256)
def _curve(key: KeyedParameter, turns: bool) -> Any:
    """Return the interpolator of a parameter over time: straight, or a monotone cubic (Fritsch & Carlson 1980)."""
    from scipy.interpolate import PchipInterpolator, make_interp_spline

    values: Floats = np.asarray(key.value, np.float64)
    if turns:
        values = np.unwrap(values, period=FULL_TURN_DEG, axis=0)
    if key.interpolation == "smooth" and len(values) > 2:
        return PchipInterpolator(key.time_s, values, axis=0)
    return make_interp_spline(key.time_s, values, k=1)
