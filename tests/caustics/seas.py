# SPDX-License-Identifier: Apache-2.0
"""Seas that several tests use."""

from __future__ import annotations

import numpy as np

from mr360uw.caustics import GerstnerSea, SpectralSea
from tests.reference import reference_arrays


def lattice_sea(rng: np.random.Generator, count: int = 8, folding: float = 0.5, tile_m: float = 8.0) -> GerstnerSea:
    """Random waves on the tile's lattice with sum Q k A = folding."""
    m = rng.integers(-9, 10, (count, 2)).astype(float)
    m[np.all(m == 0.0, axis=1)] = (1.0, 0.0)
    k = 2.0 * np.pi / tile_m * m
    length = np.linalg.norm(k, axis=1)
    share = rng.uniform(0.2, 1.0, count)
    steepness = rng.uniform(0.3, 1.0, count)
    amplitude = folding * share / share.sum() / (length * steepness)
    return GerstnerSea.from_waves(k, amplitude, steepness, rng.uniform(0.0, 2.0 * np.pi, count), tile_m=tile_m)


SEAS = {
    "gerstner": GerstnerSea(detail_slope=0.0),
    "ripples": GerstnerSea(wind_speed=2.0, detail_slope=0.03, detail_kind="ripples"),
    "blurred": GerstnerSea(),
    "phillips": SpectralSea(spectrum="phillips", wind_speed=3.0, resolution=32, detail_slope=0.0),
    "jonswap": SpectralSea(spectrum="jonswap", wind_speed=5.0, resolution=32, detail_slope=0.0),
    "tma": SpectralSea(spectrum="tma", wind_speed=5.0, resolution=32, water_depth_m=2.0, detail_slope=0.0),
}


def photon_sea(name: str) -> GerstnerSea:
    """Return the surface, "calm" or "choppy", through which the photons of the reference maps went."""
    reference = reference_arrays("photons.npz")
    waves, tile = reference[f"waves_{name}"], float(reference["tile_m"])
    return GerstnerSea.from_waves(2.0 * np.pi / tile * waves[:, :2], waves[:, 2], waves[:, 4], waves[:, 3], tile_m=tile)
