# SPDX-License-Identifier: Apache-2.0
"""Occlusion of glossy reflection: other bodies and shaded ground within the lobe of a site towards the camera.

    kept = 1 - (sum_b w_k L_k - sum_g w_k L_k c_g)/sum_k w_k L_k        instead = sum_b w_k B_b/sum_k w_k
    w    = D(n.h) V(n.v, n.l) n.l

with k the directions of `directions.py`, b those that meet a site, g those that meet a node of the ground, L the
environment, B the radiance that sites send, c the relative change of the light on the ground, D and V those of
`shading.py`. The prefiltered environment times kept plus instead is the reflected light: white bodies in white light
stay white, and nothing changes where nothing is met.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from mr360uw.composite.ambient.body_view import Body, BodyView
from mr360uw.composite.ambient.directions import directions
from mr360uw.types import Floats

LEAST_ALPHA = 0.1
"""Least width of a lobe. Its core is then as wide as the directions lie apart, 9 degrees: reflections of bodies in
smoother surfaces are blurred as much. Twice as wide, a ball of roughness .35 on the ground is off by a third more.
"""
_LEAST_COSINE = 1e-3


def reflected_among(
    body: Body, view: BodyView, camera: Floats, radiance: Floats, sent: Floats, change: Floats
) -> Floats:
    """Return (S, 6) for the sites of a body: the ratio of the environment's glossy light that is kept, and the radiance
    that is seen instead.

    camera: (3,) place in the world. radiance: (COUNT, 3) of the environment in the body's directions. sent: (all
    sites, 3) radiance of what is met. change: (NODES^2, 3) of the light on the ground at the body's nodes, from -1 on.
    """
    lattice = body.transfer.lattice
    towards = (camera - body.placed.to_world(lattice.position)) @ body.rotation
    towards /= np.maximum(np.linalg.norm(towards, axis=-1, keepdims=True), 1e-9)
    alpha = np.maximum(body.transfer.roughness**2, LEAST_ALPHA)
    out = np.zeros((len(towards), 6))
    out[:, :3] = 1.0
    met = view.met
    single = [np.ascontiguousarray(a, np.float32) for a in (lattice.normal, towards, alpha, directions().T, radiance.T)]
    _reflect(*single, met.indptr, met.indices, met.data, sent, change, out)
    return out


_compiled = numba.njit(nogil=True, cache=True, fastmath=True, error_model="numpy")


@_compiled  # type: ignore[untyped-decorator, unused-ignore]
def _weigh(normal: Any, towards: Any, alpha: Any, d: Any, weight: Any) -> None:
    """Set the weights (COUNT,) of directions (3, COUNT) in a lobe."""
    nx, ny, nz = normal[0], normal[1], normal[2]
    vx, vy, vz = towards[0], towards[1], towards[2]
    cosine = nx * vx + ny * vy + nz * vz
    if cosine < np.float32(_LEAST_COSINE):  # behind its own horizon: as seen along the surface
        lift = np.float32(_LEAST_COSINE) - cosine
        vx, vy, vz = vx + lift * nx, vy + lift * ny, vz + lift * nz
        scale = np.float32(1.0) / max(np.sqrt(vx * vx + vy * vy + vz * vz), np.float32(1e-6))
        vx, vy, vz = vx * scale, vy * scale, vz * scale
        cosine = np.float32(_LEAST_COSINE)
    one, squared = np.float32(1.0), alpha * alpha
    masked = np.sqrt(cosine * cosine * (one - squared) + squared)
    for k in range(len(weight)):
        light = max(nx * d[0, k] + ny * d[1, k] + nz * d[2, k], np.float32(0.0))
        twice = max(np.float32(2.0) + np.float32(2.0) * (vx * d[0, k] + vy * d[1, k] + vz * d[2, k]), np.float32(1e-6))
        facets = (cosine + light) * (cosine + light) / twice * (squared - one) + one
        smith = light * masked + cosine * np.sqrt(light * light * (one - squared) + squared)
        weight[k] = light / (facets * facets * smith)


@_compiled  # type: ignore[untyped-decorator, unused-ignore]
def _reflect(
    normal: Any, towards: Any, alpha: Any, d: Any, radiance: Any,
    first: Any, direction: Any, met: Any, sent: Any, change: Any, out: Any,
) -> None:  # fmt: skip
    weight = np.empty(d.shape[1], np.float32)
    for s in range(len(normal)):
        if first[s] == first[s + 1]:
            continue
        _weigh(normal[s], towards[s], alpha[s], d, weight)
        whole, red, green, blue = np.float32(1e-12), np.float32(1e-12), np.float32(1e-12), np.float32(1e-12)
        for k in range(len(weight)):
            whole += weight[k]
            red += weight[k] * radiance[0, k]
            green += weight[k] * radiance[1, k]
            blue += weight[k] * radiance[2, k]
        for p in range(first[s], first[s + 1]):
            k, number = direction[p], met[p]
            for c in range(3):
                total = red if c == 0 else green if c == 1 else blue
                lost = weight[k] * radiance[c, k] / total
                if number > 0:
                    out[s, c] -= lost
                    out[s, 3 + c] += weight[k] * sent[number - 1, c] / whole
                else:
                    out[s, c] += lost * change[-number - 1, c]
        for c in range(3):
            out[s, c] = max(out[s, c], 0.0)
