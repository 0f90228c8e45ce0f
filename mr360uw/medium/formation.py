# SPDX-License-Identifier: Apache-2.0
"""Models of image formation with one constant per channel, fitted to the solved light field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.medium.band_light import BandLight

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FormationModel:
    """The image formation model I = J exp(-beta_D z) + B (1 - exp(-beta_B z)), one constant per channel.

    direct: beta_D, backscatter: beta_B [1/m], veil: B, diffuse: attenuation of the irradiance with depth [1/m]; all
    (3,). Koschmieder 1924 has beta_D = beta_B; Akkaynak & Treibitz 2018 eq. 20 keep them apart.
    """

    direct: Array
    backscatter: Array
    veil: Array
    diffuse: Array

    @property
    def extinction(self) -> Array:
        """beta_D."""
        return self.direct

    @property
    def attenuation(self) -> Array:
        """beta_D: the model has no other."""
        return self.direct

    @property
    def level_beam(self) -> float:
        """All light at the surface, of which the model has one kind."""
        return 1.0

    def inscatter(self, distance_m: ArrayLike, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return B (1 - exp(-beta_B z)), the same in every direction and at every depth."""
        s = np.broadcast_arrays(*(np.asarray(x, np.float64) for x in (distance_m, depth_m, up)))[0][..., None]
        return -self.veil * np.expm1(-self.backscatter * s)

    def radiance(self, depth_m: ArrayLike, up: ArrayLike) -> Array:
        """Return B."""
        shape = np.broadcast_shapes(np.shape(depth_m), np.shape(up))
        return np.broadcast_to(self.veil, (*shape, 3))

    def irradiance(self, depth_m: ArrayLike, normal_up: ArrayLike) -> Array:
        """Return exp(-diffuse y) for every normal."""
        y = np.broadcast_arrays(np.asarray(depth_m, np.float64), np.asarray(normal_up))[0]
        return np.exp(-self.diffuse * y[..., None])


def fitted_formation(solved: BandLight, camera_depth_m: float, *, one_attenuation: bool) -> FormationModel:
    """Return the constants that agree with a solved field on a level ray of one fading length at the camera's depth.

    one_attenuation: beta_B = beta_D (Koschmieder), else beta_B is fitted to the veil.
    """
    depth, s = camera_depth_m, solved.fading_length_m(camera_depth_m)
    direct = -solved.transmittance_log(np.array(s), np.array(depth)) / s
    far = solved.display(solved.model.inscatter(np.array(1e4 * s), depth, np.array(0.0)))
    near = solved.display(solved.model.inscatter(np.array(s), depth, np.array(0.0)))
    backscatter = direct if one_attenuation else -np.log1p(-near / far) / s
    log = solved.ambient_log(np.array([depth, 0.0]))
    return FormationModel(direct, backscatter, far, (log[1] - log[0]) / depth)
