# SPDX-License-Identifier: Apache-2.0
"""Occlusion of glossy reflection: other bodies and shaded ground within the lobe of a sample towards the camera.

    kept = 1 - sum_m p w_k L_k/sum_k w_k L_k        instead = sum_m p w_k B_m/sum_k w_k
    w    = D(n.h) V(n.v, n.l) n.l

with k the directions of `directions.py`, m those that meet a coarse sample, a node of the ground or ground farther off,
p the part of the direction that they fill, L the environment at the camera, B the radiance that coarse samples and
ground send, D and V those of `shading.py`. The prefiltered environment times kept plus instead is the reflected light:
white bodies in white light stay white, and nothing changes where nothing is met.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mr360uw.composite.ambient.body import Body
from mr360uw.composite.ambient.directions import directions
from mr360uw.composite.ambient.form_factors import Met
from mr360uw.jit import fast
from mr360uw.types import Floats

LEAST_ALPHA = 0.1
"""Least width of a lobe. Its core is then as wide as the directions lie apart, 9 degrees: reflections of bodies in
smoother surfaces are blurred as much. Twice as wide, a ball of roughness .35 on the ground is off by a third more.
"""
_LEAST_COSINE = 1e-3


def reflected_among(
    body: Body, met: Met, camera: Floats, radiance: Floats, around: Floats, sent: Floats, ground: Floats
) -> Floats:
    """Return (S, 6) for the samples of a body: the ratio of the environment's glossy light that is kept, and the
    radiance that is seen instead.

    camera: (3,) place in the world. radiance, around: (COUNT, 3) of the environment in the body's directions, as the
    camera and as the body sees it. sent: (all coarse samples, 3) radiance of what is met; ground: (NODES^2, 3) of the
    nodes.
    """
    lattice = body.transfer.lattice
    towards = (camera - body.placed.to_world(lattice.position)) @ body.rotation
    towards /= np.maximum(np.linalg.norm(towards, axis=-1, keepdims=True), 1e-9)
    alpha = np.maximum(body.transfer.roughness**2, LEAST_ALPHA)
    out = np.zeros((len(towards), 6))
    out[:, :3] = 1.0
    normal, ways = np.ascontiguousarray(lattice.normal, np.float32), np.ascontiguousarray(directions().T, np.float32)
    towards, alpha = towards.astype(np.float32), alpha.astype(np.float32)
    light, at_body = (np.ascontiguousarray(a.T, np.float32) for a in (radiance, around))
    _reflect(
        normal, towards, alpha, ways, light, at_body, np.flatnonzero(np.any(light != at_body, axis=0)),
        met.begin, met.direction, met.target, met.part, sent, ground, out,
    )  # fmt: skip
    return out


@fast
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
        facets = max(facets, np.float32(0.5) * squared)  # below the horizon it may be 0, as the light
        smith = light * masked + cosine * np.sqrt(light * light * (one - squared) + squared)
        weight[k] = light / (facets * facets * smith)


@fast
def _reflect(
    normal: Any, towards: Any, alpha: Any, d: Any, radiance: Any, around: Any, moved: Any,
    first: Any, direction: Any, target: Any, part: Any, sent: Any, ground: Any, out: Any,
) -> None:  # fmt: skip
    weight, far = np.empty(d.shape[1], np.float32), np.zeros(d.shape[1], np.bool_)
    far[moved] = True
    for s in range(len(normal)):
        if first[s] == first[s + 1] and len(moved) == 0:
            continue
        _weigh(normal[s], towards[s], alpha[s], d, weight)
        whole = np.float32(1e-12)
        for k in range(len(weight)):
            whole += weight[k]
        for c in range(3):
            seen, lost, instead = np.float32(1e-12), np.float32(0.0), np.float32(0.0)
            for k in range(len(weight)):
                seen += weight[k] * radiance[c, k]
            for k in moved:
                lost += weight[k] * radiance[c, k]
                instead += weight[k] * around[c, k]
            for p in range(first[s], first[s + 1]):
                k, number = direction[p], target[p]
                filled = part[p] * weight[k]
                if far[k]:
                    instead -= filled * around[c, k]
                else:
                    lost += filled * radiance[c, k]
                instead += filled * (sent[number - 1, c] if number > 0 else ground[-number - 1, c])
            out[s, c] = max(np.float32(1.0) - lost / seen, np.float32(0.0))
            out[s, 3 + c] = max(instead, np.float32(0.0)) / whole
