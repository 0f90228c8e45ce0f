# SPDX-License-Identifier: Apache-2.0
"""The integral that `ibl.filters` is fitted to."""

from __future__ import annotations

import numpy as np


def split_sum_integral(roughness: float, n_dot_v: float, samples: int = 256) -> tuple[float, float]:
    """Return (A, B) by midpoint quadrature over half vectors spread as the GGX distribution (Karis 2013)."""
    alpha2 = max(roughness, 1e-3) ** 4
    u = (np.arange(samples) + 0.5) / samples
    cos_h = np.sqrt((1.0 - u) / (1.0 + (alpha2 - 1.0) * u))[:, None]
    sin_h = np.sqrt(np.maximum(1.0 - cos_h**2, 0.0))
    phi = np.pi * u[None, :]  # the other half is its mirror image
    v_dot_h = np.sqrt(1.0 - n_dot_v**2) * sin_h * np.cos(phi) + n_dot_v * cos_h
    n_dot_l = 2.0 * v_dot_h * cos_h - n_dot_v
    valid = (n_dot_l > 0.0) & (v_dot_h > 0.0)
    lit = np.where(valid, n_dot_l, 1.0)
    smith_v = lit * np.sqrt(n_dot_v**2 * (1.0 - alpha2) + alpha2)
    smith_l = n_dot_v * np.sqrt(lit**2 * (1.0 - alpha2) + alpha2)
    masking = 2.0 * lit * n_dot_v / (smith_v + smith_l)
    weight = np.where(valid, masking * v_dot_h / (cos_h * n_dot_v), 0.0)
    fresnel = np.power(1.0 - np.clip(v_dot_h, 0.0, 1.0), 5.0)
    return float(np.mean(weight * (1.0 - fresnel))), float(np.mean(weight * fresnel))
