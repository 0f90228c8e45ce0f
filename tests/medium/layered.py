# SPDX-License-Identifier: Apache-2.0
"""Profiles of layered water, as files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mr360uw.medium import Water

NM = np.arange(400.0, 701.0, 12.5)
"""Wavelengths of the files [nm]."""
DEPTHS = np.linspace(0.0, 30.0, 16)
PROFILES = {
    "clear over murky": ([0.0, 6.0, 6.001, 20.0], [0.0, 0.0, 1.0, 1.0]),
    "murky over clear": ([0.0, 6.0, 6.001, 20.0], [1.0, 1.0, 0.0, 0.0]),
    "smooth": (DEPTHS.tolist(), np.exp(-(((DEPTHS - 12.0) / 5.0) ** 2)).tolist()),
}
"""Depths [m], and how far the water is from type IB, 0, to 3C, 1."""


def write_profile(path: Path, depth_m: list[float], murky: list[float], nm: np.ndarray = NM) -> Path:
    """Write the profile of a water between type IB and 3C, and return its path."""
    clear, other = Water.jerlov("IB"), Water.jerlov("3C")
    rows = ["depth_m,wavelength_nm,absorption,scattering"]
    for depth, share in zip(depth_m, murky, strict=True):
        a, b = ((1.0 - share) * f(nm) + share * g(nm) for f, g in (
            (clear.absorption, other.absorption), (clear.scattering, other.scattering)
        ))  # fmt: skip
        rows += [f"{depth!r},{w!r},{p!r},{q!r}" for w, p, q in np.stack([nm, a, b], axis=-1).tolist()]
    path.write_text("\n".join(rows), "utf-8")
    return path
