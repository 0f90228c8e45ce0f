# SPDX-License-Identifier: Apache-2.0
"""Shot: everything that the layer of one frame depends on, with its objects and the plate's receiver."""

from __future__ import annotations

import operator
from dataclasses import dataclass, field

import numpy as np

from mr360uw.base.cache import Parts
from mr360uw.base.color import LEAST_CHANGE
from mr360uw.composite.mesh.mesh import Mesh
from mr360uw.composite.mesh.polygons import scale_of
from mr360uw.composite.receiver.pattern import PlatePattern
from mr360uw.composite.settings import DrawSettings, SurfaceSettings
from mr360uw.types import CausticStack, Environment, Floats, Light, MediumTable, View

SHADOW_BIAS = 0.006
"""Offset of shadow rays as a fraction of the body's longest side: 1.5 texels of a shadow map 256 texels wide. Half as
large, bodies shade themselves in stripes; twice as large, contact shadows are visibly detached."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedObject(Parts):
    """A mesh in the world. world_from_object: (4, 4), rotation, uniform scale and translation."""

    mesh: Mesh
    world_from_object: Floats
    casts_shadow: bool = True
    visible: bool = True

    @property
    def scale(self) -> float:
        """Metres in the world for a metre of the mesh."""
        return scale_of(self.world_from_object[:3, :3])

    @property
    def bias_m(self) -> float:
        """Offset [m] of the body's shadow rays from its own surface."""
        return SHADOW_BIAS * float(np.max(self.mesh.extent_m)) * self.scale

    @property
    def triangles(self) -> Floats:
        """Its triangles (T, 3, 3) [m] in the world."""
        return self.to_world(self.mesh.positions)

    def to_world(self, points: Floats) -> Floats:
        """Return points (..., 3) of the object in the world."""
        placed = points.reshape(-1, 3) @ self.world_from_object[:3, :3].T + self.world_from_object[:3, 3]
        return placed.reshape(points.shape)


@dataclass(frozen=True, slots=True, eq=False)
class Receiver:
    """The surface of the plate that catches shadows: exactly one of the three shapes.

    plane_y: height [m] of a horizontal plane in the world. mesh: triangles (T, 3, 3) in the world. distance_m: (h, w)
    distances along the camera's rays, a frame of any size, 0, infinite or NaN where there is none. shadow, occlusion,
    caustics: whether it shows them. extent_m: distance from the camera beyond which it does not change.
    """

    plane_y: float | None = None
    mesh: Floats | None = None
    distance_m: Floats | None = None
    shadow: bool = True
    occlusion: bool = True
    caustics: bool = False
    extent_m: float = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class LightSample:
    """Bodies, light and water at a sample in time, for which the ambient light of bodies is solved.

    environment: in world axes. lights: its sun, if any. position: (3,) [m] of the camera in the world.
    """

    objects: tuple[PlacedObject, ...]
    environment: Environment
    lights: tuple[Light, ...]
    medium: MediumTable | None
    position: Floats


@dataclass(frozen=True, slots=True, eq=False)
class BetweenSamples:
    """Place of an instant between two samples in time. share: 0 at the sample before, 1 at that after."""

    before: LightSample
    after: LightSample
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class Shot(Parts):
    """One instant of a frame: view, objects, light, water and sampling settings.

    environment: ambient light, in world axes. lights: sun (at most one) and lamps, in world axes. medium: None without
    water. caustics: of the sun. holdout: (H, W) in [0, 1], the fraction of the plate in front of the objects.
    holdout_distance_m: (H, W) [m]; objects beyond it are hidden. holdout_soft: whether the edges of what it hides are
    soft, over about a pixel. holdout_beside: another such distance (H, W) [m], and the fraction (H, W), 0 to 0.5, of
    pixels along edges that it holds for. pattern: the plate's own caustics on the receiver, which shadows remove; None
    leaves them.
    unseen: relative change of light that does not show in the plate's codes (`color.unseen_change`).
    between: two samples in time about this instant, between which the solved ambient light of bodies is interpolated
    where they move little; None solves it for this instant.
    """

    view: View
    objects: tuple[PlacedObject, ...]
    environment: Environment
    lights: tuple[Light, ...] = ()
    medium: MediumTable | None = None
    caustics: CausticStack | None = None
    receiver: Receiver | None = None
    holdout: Floats | None = None
    holdout_distance_m: Floats | None = None
    holdout_soft: bool = False
    holdout_beside: tuple[Floats, Floats] | None = None
    pattern: PlatePattern | None = None
    draw: DrawSettings = field(default_factory=DrawSettings)
    unseen: float = LEAST_CHANGE
    between: BetweenSamples | None = None

    @property
    def visible(self) -> tuple[PlacedObject, ...]:
        """The objects that the camera sees."""
        return tuple(filter(operator.attrgetter("visible"), self.objects))

    @property
    def casters(self) -> tuple[PlacedObject, ...]:
        """The objects that cast shadows."""
        return tuple(filter(operator.attrgetter("casts_shadow"), self.objects))

    @property
    def has_mattes(self) -> bool:
        """Whether parts of the plate may stand in front of the objects."""
        return self.holdout is not None or self.holdout_distance_m is not None

    @property
    def refractive_index(self) -> float:
        """Refractive index around the objects, relative to air: the water's, or 1 without water."""
        return 1.0 if self.medium is None else self.medium.refractive_index


WITHIN_M = 3.0
"""Greatest depth of an object's top at which "auto" shows it in the surface; images fade in over its last quarter."""
FAINTEST = 1e-3
"""Transmittance of the whole way, in its clearest channel, below which a body is not seen in the surface."""


def object_presence(shot: Shot, settings: SurfaceSettings) -> Floats:
    """Return for each visible object of a shot the fraction (n,) in which the surface shows it, by its top's depth."""
    depth = shot.view.surface_y_m - tops(shot)
    if settings.objects == "all":
        return np.ones(len(depth))
    return np.clip(4.0 * (1.0 - depth / WITHIN_M), 0.0, 1.0)


def tops(shot: Shot) -> Floats:
    """Return the height (n,) [m] in the world of the highest point of each visible object."""
    return np.array([o.to_world(o.mesh.hull.reshape(-1, 3))[:, 1].max() for o in shot.visible])
