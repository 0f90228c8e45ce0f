# SPDX-License-Identifier: Apache-2.0
"""Slabs of the literature as water between a surface that neither reflects nor refracts and a Lambert floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mr360uw.medium import LightField
from mr360uw.medium.ray_field import LambertFloor
from tests.reference import reference_rows

LEAST_ABSORPTION = 1e-9
"""Stands for none, which the field does not take; a tenth or ten times as much changes no light by more than 1e-7."""
_MOMENTS = 200


@dataclass(frozen=True)
class Slab:
    """A slab of optical thickness `thickness` and single-scattering albedo `omega` over a floor of an albedo.

    sun_up: y of the direction to a sun that is all of the light, 0 for a uniform sky.
    """

    phase: str
    omega: float
    thickness: float
    sun_up: float
    albedo: float

    def field(self, streams: int) -> LightField:
        """Return its light; a metre is an optical length of 1."""
        kind, *g = self.phase.split()
        return LightField(
            max(1.0 - self.omega, LEAST_ABSORPTION), self.omega, ("hg", float(g[0])) if g else moments(kind), "none",
            ("sun", self.sun_up, 1.0) if self.sun_up else "uniform", streams=streams,
            floor=LambertFloor(self.thickness, (self.albedo,)),
        )  # fmt: skip


def moments(kind: str) -> np.ndarray:
    """Return the Legendre moments of a phase function that is a sum of them."""
    known = {"isotropic": [1.0], "rayleigh": [1.0, 0.0, 0.1]}
    if kind == "haze-l":
        known[kind] = [float(row["moment"]) / (2 * int(row["degree"]) + 1) for row in reference_rows("haze_l.csv")]
    return np.append(known[kind], np.zeros(_MOMENTS - len(known[kind])))


def slabs(name: str) -> dict[Slab, list[dict[str, str]]]:
    """Return the rows of a file of reference values by their slab."""
    found: dict[Slab, list[dict[str, str]]] = {}
    for row in reference_rows(name):
        numbers = (float(row[key]) for key in ("omega", "thickness", "sun_up", "albedo"))
        found.setdefault(Slab(row["phase"], *numbers), []).append(row)
    return found


def errors(slab: Slab, rows: list[dict[str, str]], streams: int) -> tuple[float, float]:
    """Return the largest errors of radiances, over the largest of the slab, and of irradiances, over the incident."""
    field = slab.field(streams)
    off: dict[str, list[float]] = {"radiance": [0.0], "irradiance": [0.0]}
    largest = max((float(row["value"]) for row in rows if row["kind"] == "radiance"), default=1.0)
    for azimuth in {row["azimuth_deg"] for row in rows}:
        seen = field.at_azimuth(np.radians(float(azimuth))) if slab.sun_up else field
        for kind in off:
            part = [row for row in rows if row["kind"] == kind and row["azimuth_deg"] == azimuth]
            if part:
                depth, up, value = (np.array([float(row[key]) for row in part]) for key in ("depth", "up", "value"))
                off[kind] += np.abs(getattr(seen, kind)(depth, up)[:, 0] - value).tolist()
    return max(off["radiance"]) / largest, max(off["irradiance"])
