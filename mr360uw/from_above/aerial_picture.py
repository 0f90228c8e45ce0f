# SPDX-License-Identifier: Apache-2.0
"""Pictures of a shallow sea by a camera in the air."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mr360uw.composite.objects import load_objects, on_the_floor, on_the_sea
from mr360uw.composite.over import over
from mr360uw.composite.shot import Receiver
from mr360uw.constants import LUMINANCE_B, LUMINANCE_G, LUMINANCE_R, PI
from mr360uw.errors import ParameterError
from mr360uw.from_above.aerial_bodies import AerialBodies, brightened
from mr360uw.from_above.first_surface import floor_radiance, floor_through_waves, reflected_radiance
from mr360uw.from_above.scene_parts import sea_scene_of
from mr360uw.from_above.settings import AerialScene
from mr360uw.published.aerial_look import thresholded_reflection
from mr360uw.shapes import checked
from mr360uw.sphere import yaw_matrix
from mr360uw.surface import SeaScene, SurfacePicture
from mr360uw.surface.sea_picture import rendered
from mr360uw.surface.tracing.stage_arrays import RayStage
from mr360uw.types import Floats, Layer, View

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class AerialPicture:
    """A picture from above.

    image_linear: (H, W, 3) float32, linear Rec.709, times the exposure: a level white card on the shore has the value
    of `camera.exposure`. What follows is of the ray through each pixel's centre at its first meeting with the waves;
    radiances are exposed too.
    normal: (H, W, 3) of the surface, +y up, zero where there is none. floor_radiance: (H, W, 3) that leaves the floor
    on the refracted ray, before water and surface take their part, or on the ray itself where it is dry; zero
    elsewhere. reflection: (H, W, 3) that the surface mirrors. distance_m: (H, W) to the surface or the dry floor,
    infinity for the sky. in_water_m: (H, W) length of the refracted ray down to the floor, 0 where there is none.
    body_alpha: (H, W) fraction of each pixel that bodies cover; the other arrays are without them. view: the camera.
    time_s: of the picture.
    """

    image_linear: NDArray[np.float32]
    normal: Floats
    floor_radiance: Floats
    reflection: Floats
    distance_m: Floats
    in_water_m: Floats
    body_alpha: Floats
    view: View
    time_s: float


@dataclass(frozen=True, slots=True, eq=False)
class LoadedAerial:
    """A scene with its files read and its water solved, for any number of pictures.

    sea: without bodies. exposure: factor on radiance. bodies: None where there are none.
    """

    scene: AerialScene
    sea: SeaScene
    exposure: float
    bodies: AerialBodies | None = None

    @classmethod
    @checked
    def of(cls, scene: AerialScene) -> LoadedAerial:
        """Return it; raise `ParameterError`, `VideoError` or `MeshError` for files that cannot be used."""
        sea = sea_scene_of(scene)
        light = np.asarray(sea.dome.irradiance, np.float64)
        if sea.sun is not None:
            light = light + sea.sun.irradiance * max(float(sea.sun.direction[1]), 0.0)
        level = float(light @ np.array([LUMINANCE_R, LUMINANCE_G, LUMINANCE_B]))
        if not level > 0.0:
            raise ParameterError("sun, sky - give no light (got 0) - set sun.irradiance or sky.irradiance")
        ground = Receiver(plane_y=-scene.floor.depth_m)
        afloat = tuple(on_the_floor(on_the_sea(one, sea.sea, 0.0), ground) for one in load_objects(scene.objects))
        bodies = AerialBodies(sea, afloat) if afloat else None
        return cls(scene, sea, scene.camera.exposure * PI / level, bodies)

    def view(self, time_s: float = 0.0, size: tuple[int, int] | None = None) -> View:
        """Return the camera at a time [s]. size: (width, height) of the picture instead of the scene's."""
        camera = self.scene.camera
        width, height = size or (camera.width, camera.height)
        if min(width, height) < 1:
            raise ParameterError(f"size - must be 1 or more pixels (got {width}x{height}) - give (1280, 720)")
        position = np.array(camera.position_m) + time_s * np.array(camera.velocity_m_s)
        turned = yaw_matrix(math.radians(camera.yaw_deg + time_s * camera.turn_deg_s))
        return View(
            width, height, position, turned @ _tilt(camera.pitch_deg, camera.roll_deg), 0.0, camera.projection,
            math.radians(camera.fov_deg), camera.width_m,
        )  # fmt: skip

    def picture(self, time_s: float = 0.0, size: tuple[int, int] | None = None) -> AerialPicture:
        """Return the picture at a time [s], the same alone and within a film; see `view`."""
        view = self.view(time_s, size)
        samples = self.scene.film.samples
        stage = self.sea.stage(view, time_s, samples * samples)
        seen = self._seen(stage, view, time_s, samples)
        directions, origins = _middle_rays(view)
        below = floor_radiance(stage, view, seen, directions, origins)
        mirrored = self._mirrored(stage, view, seen, directions)
        layer = self._layer(stage, view, seen, mirrored, time_s)
        sharp = self._sharp(seen, directions)
        image = np.asarray(over(seen.radiance + sharp, layer), np.float64)
        e = self.exposure
        return AerialPicture(
            (e * image).astype(np.float32), seen.normal, e * below, e * mirrored, seen.distance_m, seen.in_water_m,
            layer.alpha, view, time_s,
        )  # fmt: skip

    def layer(self, time_s: float = 0.0, size: tuple[int, int] | None = None) -> Layer:
        """Return the bodies alone at a time [s], exposed, as a layer over a picture of the same view."""
        view = self.view(time_s, size)
        stage = self.sea.stage(view, time_s, 1)
        seen = self._seen(stage, view, time_s, 1)
        mirrored = self._mirrored(stage, view, seen, _middle_rays(view)[0])
        return brightened(self._layer(stage, view, seen, mirrored, time_s), self.exposure)

    @property
    def _thresholded(self) -> bool:
        return self.scene.reflection.sun == "thresholded"

    def _seen(self, stage: RayStage, view: View, time_s: float, samples: int) -> SurfacePicture:
        """Return the sea without bodies, and without the sun's reflection where that is drawn apart."""
        if self._thresholded:
            return rendered(replace(stage, sun=None), view, samples)
        return self.sea.picture(view, time_s, samples=samples)

    def _mirrored(self, stage: RayStage, view: View, seen: SurfacePicture, directions: Array) -> Array:
        """Return the radiance (H, W, 3) that the first surface reflects."""
        if not self._thresholded:
            return reflected_radiance(stage, view, seen, directions)
        sky = reflected_radiance(replace(stage, sun=None), view, seen, directions)
        return sky + self._sharp(seen, directions)

    def _layer(self, stage: RayStage, view: View, seen: SurfacePicture, mirrored: Array, time_s: float) -> Layer:
        if self.bodies is None:
            return Layer(view.height, view.width, ())
        frame = round(time_s * self.scene.film.frame_rate)  # of meshes that change from frame to frame
        floor = floor_through_waves(stage, view, seen, *_middle_rays(view))
        return self.bodies.layer(stage, view, floor, mirrored, time_s, frame, self.scene.caustics)

    def _sharp(self, seen: SurfacePicture, directions: Array) -> Array:
        """Return the radiance (H, W, 3) of the thresholded reflection of the sun, zero for other reflections."""
        sun, reflection = self.sea.sun, self.scene.reflection
        if not self._thresholded or sun is None or seen.camera_in_water:
            return np.zeros(seen.radiance.shape)
        part = thresholded_reflection(directions, seen.normal, sun, math.radians(reflection.threshold_deg))
        return part[..., None] * (reflection.gain * sun.irradiance)


@checked
def aerial(scene: AerialScene, *, time_s: float = 0.0, size: tuple[int, int] | None = None) -> AerialPicture:
    """Return a picture of the sea from the air.

    The floor is seen through moving waves, with caustics and the mirrored sky. A level white card on the shore has the
    value of `camera.exposure`.

    Parameters
    ----------
    scene : AerialScene
        The scene, of `load_aerial`, or made from its tables.
    time_s : float
        Time [s] of the sea.
    size : tuple of int, optional
        Width and height in pixels instead of the camera's.

    Returns
    -------
    AerialPicture
        Linear light `image_linear` (H, W, 3), distances and masks.

    Raises
    ------
    ParameterError
        If the scene cannot be seen, as from below the floor.
    VideoError
        If its sky cannot be read.

    See Also
    --------
    uw.load_aerial : Reads the scene.
    uw.from_above.LoadedAerial : Keeps what does not change, for several pictures.
    uw.from_above.aerial_film : Writes pictures or a video.

    Examples
    --------
    >>> above = uw.AerialScene(caustics={"size": 64, "grid": 64}, sea={"resolution": 32})
    >>> uw.aerial(above, size=(16, 8)).image_linear.shape
    (8, 16, 3)
    """
    return LoadedAerial.of(scene).picture(time_s, size)


def _tilt(pitch_deg: float, roll_deg: float) -> Array:
    """Return the rotation (3, 3) of a camera without yaw: roll about its axis, right side down, then pitch, up."""
    c, s = math.cos(math.radians(pitch_deg)), math.sin(math.radians(pitch_deg))
    a, b = math.cos(math.radians(roll_deg)), math.sin(math.radians(roll_deg))
    pitch = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return np.asarray(pitch @ np.array([[a, b, 0.0], [-b, a, 0.0], [0.0, 0.0, 1.0]]))


def _middle_rays(view: View) -> tuple[Array, Array]:
    """Return the directions and origins (H, W, 3) of the rays through the pixels' centres."""
    x, y = np.arange(view.width) + 0.5, np.arange(view.height)[:, None] + 0.5
    return np.asarray(view.directions(x, y), np.float64), np.asarray(view.origins(x, y), np.float64)
