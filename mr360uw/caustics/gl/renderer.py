# SPDX-License-Identifier: Apache-2.0
"""Caustics on OpenGL 3.3: the flux of refracted cells shared over pixels by exact coverage, as in `irradiance`.

Passes: surface (once for each frame); rays and cell flux (for each refractive index); then for each plane cells drawn
into an additive target, fold, sun disc. A cell is drawn as a point whose square covers its refracted image, and each
pixel of the square takes the exact area. Cells larger than the driver's largest point become rectangles. A cell starts
in the tile and the target spans two tiles each way, so the grid is drawn once and the fold adds the flux beyond the
edges. Maps are divided by the incoming flux only, so that their mean tests the method.

Where OpenGL runs on the processor, stacks are made by `blurred_stack` and uploaded: summing along the cells' edges
takes a fifth of the time of drawing their squares, and summing points a fiftieth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import moderngl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mr360uw.caustics.flux.blurred_stack import blurred_stack
from mr360uw.caustics.flux.irradiance import beam_slope, check_arguments, pass_indices
from mr360uw.caustics.flux.resolution import grid_of
from mr360uw.caustics.flux.shadowed import IN_SHADOW, shadow_steps
from mr360uw.caustics.flux.soft_light import gaussians, is_soft
from mr360uw.caustics.gl.atlas import layer_planes
from mr360uw.caustics.gl.blurs import NO_BLUR_PIXELS, disc_blur, gaussian_blur, gaussian_sum
from mr360uw.caustics.gl.passes import Passes, Textures
from mr360uw.caustics.gl.plane import CausticPlane
from mr360uw.caustics.gl.published.mesh_drawing import draw_mesh, scrolled
from mr360uw.caustics.gl.sea_textures import field_image, wave_table
from mr360uw.caustics.gl.stack import AtlasRoom, GlCausticStack, on_device, upload
from mr360uw.caustics.published.scrolling import scroll
from mr360uw.caustics.sea.base import check_time
from mr360uw.caustics.sea.gerstner import GerstnerSea
from mr360uw.caustics.settings import DIVIDED_AREAS, CausticSettings, Method, Sea
from mr360uw.constants import REFRACTIVE_INDEX_SEA, SUN_HALF_ANGLE_RAD
from mr360uw.gl.context import gl_context, gl_device, per_thread, read_framebuffer, texture_from_array
from mr360uw.optics import fresnel_transmittance, refract_to_water
from mr360uw.types import BeamSpread, Floats

Array = NDArray[np.floating[Any]]


@per_thread
def caustic_renderer() -> CausticRenderer:
    """Return this thread's renderer, made at the first call."""
    return CausticRenderer()


class CausticRenderer:
    """Makes caustic maps and stacks; keeps its programs and textures from frame to frame.

    draws_stacks: True draws stacks, False makes them on the processor and uploads them. None draws on graphics hardware
    only.
    """

    def __init__(self, *, draws_stacks: bool | None = None) -> None:
        self._draws_stacks = not gl_device().software if draws_stacks is None else draws_stacks
        self._passes, self._atlases = Passes(), AtlasRoom()
        self._point_limit = float(gl_context().info["GL_POINT_SIZE_RANGE"][1])

    def map(
        self,
        sea: Sea,
        sun_direction_in_air: ArrayLike,
        depth_m: float,
        time_s: float,
        size: int = 512,
        grid: int = 256,
        refractive_index: float = REFRACTIVE_INDEX_SEA,
        sun_half_angle_rad: float = SUN_HALF_ANGLE_RAD,
        method: Method = "exact",
    ) -> Floats:
        """Return the irradiance ratio (size, size) of `irradiance.caustic_map`."""
        sun = check_arguments(sun_direction_in_air, [depth_m], size, grid, refractive_index, sun_half_angle_rad)
        self._surface(sea, sun, grid, 0.0 if method == "scrolling" else time_s)
        total = self._rays(sun, refractive_index, grid, "rays 0")
        plane = CausticPlane(
            sea.tile_m, sun, depth_m, size, grid, refractive_index, sun_half_angle_rad, method,
            blur_slope=sea.blur_slope,
        )  # fmt: skip
        light = self._light(plane, 0, "light")
        incoming = float(read_framebuffer(self._passes.target([total]), 1)[0, 0, 0])
        ratio = read_framebuffer(self._passes.target([light]), 1)[..., 0] / np.float32(incoming)
        return scroll(ratio, sea, time_s) if method == "scrolling" else ratio

    def stack(
        self,
        sea: Sea,
        sun_direction_in_air: ArrayLike,
        depths_m: Sequence[float] | Array,
        time_s: float,
        settings: CausticSettings | None = None,
        refractive_index: float = REFRACTIVE_INDEX_SEA,
        spread: BeamSpread | None = None,
    ) -> GlCausticStack:
        """Return the stack of `irradiance.caustic_stack` on the GPU, mip levels included."""
        s = settings or CausticSettings()
        grid = grid_of(s, sea)
        sun = check_arguments(sun_direction_in_air, depths_m, s.size, grid, refractive_index, s.sun_half_angle_rad)
        depths = np.asarray(depths_m, np.float64)
        gl_context().gc()
        if not self._draws_stacks:
            made = blurred_stack(sea, sun, depths, time_s, s, refractive_index, spread)
            return upload(made, self._atlases)
        sun_in_water = refract_to_water(sun, refractive_index)
        indices, planes = pass_indices(s.chromatic, refractive_index), layer_planes(len(depths))
        turned = spread if is_soft(spread, depths[-1], sun_in_water) else None
        levels = s.size.bit_length()
        texture = gl_context().texture_array(
            (s.size + 2, 2 * s.size + 2 * levels, len(planes) * (len(indices) + (turned is not None))),
            planes.shape[1],
            dtype="f4",
        )
        target = gl_context().framebuffer([texture])
        self._surface(sea, sun, grid, 0.0 if s.method == "scrolling" else time_s)
        for channel, index in enumerate(indices):
            lights, totals = [], []
            total = self._rays(sun, index, grid, f"rays {channel}")
            for number, depth in enumerate(depths.tolist()):
                plane = CausticPlane(
                    sea.tile_m, sun, depth, s.size, grid, index, s.sun_half_angle_rad, s.method,
                    beam_slope(sun_in_water), sea.blur_slope,
                )  # fmt: skip
                light = self._light(plane, channel, f"light {number}")
                if s.method == "scrolling":
                    light = scrolled(self._passes, light, sea, time_s, f"scrolled light {number}")
                    total = self._mean(light, s.size, f"scrolled {number}")
                light.build_mipmaps()
                lights.append(light)
                totals.append(total)
            self._atlas(target, lights, totals, planes, s.size, (channel, len(indices)))
            if turned is not None and channel == len(indices) // 2:
                for number, depth in enumerate(depths.tolist()):
                    blurs = gaussians(turned, depth, sun_in_water, sea.tile_m / s.size)
                    name, scale = f"soft light {number}", s.size / sea.tile_m
                    lights[number] = gaussian_sum(self._passes, name, lights[number], blurs, scale)
                    lights[number].build_mipmaps()
                self._atlas(target, lights, totals, planes, s.size, (len(planes) * len(indices), 1))
        return on_device(texture, depths, sea.tile_m, sun_in_water, softened=turned is not None)

    def _atlas(
        self,
        target: moderngl.Framebuffer,
        lights: list[moderngl.Texture],
        totals: list[moderngl.Texture],
        planes: NDArray[np.int64],
        size: int,
        layers: tuple[int, int],
    ) -> None:
        """Draw the planes of one colour. lights, totals: of each plane. layers: the first layer, and the step."""
        for layer, held in enumerate(planes):
            inputs = {f"light_{k}": lights[p] for k, p in enumerate(held)}
            inputs |= {f"total_{k}": totals[p] for k, p in enumerate(held)}
            self._passes.draw(
                target, "atlas", inputs, geometry="caustics/gl/layer.geom", PLANES=planes.shape[1], size=size,
                last=size.bit_length() - 1, layer=layers[0] + layer * layers[1],
            )  # fmt: skip

    def _surface(self, sea: Sea, sun: Array, grid: int, time_s: float) -> None:
        """Fill "position", "normal" and "lit"."""
        check_time(time_s)
        inputs: dict[str, moderngl.Texture] = {}
        uniforms: dict[str, Any] = {"grid": grid, "detail__repeats": (0.0, 0.0)}
        if isinstance(sea, GerstnerSea) and sea.tiling == "lattice":
            inputs["waves"] = texture_from_array(wave_table(sea.waves, sea.tile_m, time_s))
            uniforms["wave_count"] = len(sea.waves.amplitude_m)
            range_m = 2.0 * float(np.sum(sea.waves.amplitude_m))
        else:
            image = field_image(sea, grid, time_s)
            inputs["fields"] = texture_from_array(image)
            uniforms["FIELDS"] = 1
            range_m = sea.tile_m * float(np.ptp(image[:grid, :, 0]))
        detail = sea.detail(time_s)
        if detail is not None:
            inputs["slopes"] = texture_from_array(detail.slopes)
            uniforms |= {"detail__repeats": detail.repeats, "detail__offset": detail.offset}
        targets = [self._passes.texture(name, grid, grid, 4) for name in ("position", "normal")]
        self._passes.fill(targets, "surface", inputs, **uniforms)
        towards = (*(sun[[0, 2]] / max(np.hypot(sun[0], sun[2]), 1e-9)), sun[1] / max(np.hypot(sun[0], sun[2]), 1e-9))
        self._passes.fill(
            [self._passes.texture("lit", grid, grid)], "lit", {"position": targets[0]}, towards=towards, grid=grid,
            steps=shadow_steps(range_m, sun, sea.tile_m, grid), dark=IN_SHADOW,
        )  # fmt: skip

    def _rays(self, sun: Array, refractive_index: float, grid: int, name: str) -> moderngl.Texture:
        """Fill the rays and the flux of each cell; return the mean flux of a cell, a texture of one texel."""
        targets = [self._passes.texture(name, grid, grid, 4), self._passes.texture(f"{name} flux", grid, grid, 2)]
        inputs = {name: self._passes[name] for name in ("position", "normal", "lit")}
        self._passes.fill(
            targets, "rays", inputs, sun_in_air=sun, refractive_index=refractive_index, grid=grid,
            flat_flux=float(sun[1] * fresnel_transmittance(sun[1], refractive_index)) / grid**2,
        )  # fmt: skip
        return self._mean(targets[1], grid, name)

    def _mean(self, image: moderngl.Texture, size: int, name: str) -> moderngl.Texture:
        """Return the mean over size x size texels of the sum of an image's first two channels."""
        column, mean = self._passes.texture(f"{name} column", 1, size), self._passes.texture(f"{name} mean", 1, 1)
        self._passes.fill([column], "mean", {"image": image}, axis=(1, 0), count=size)
        self._passes.fill([mean], "mean", {"image": column}, axis=(0, 1), count=size)
        return mean

    def _light(self, plane: CausticPlane, channel: int, name: str) -> moderngl.Texture:
        """Return the light of one plane, folded and blurred, in units of the flat sea's."""
        size, passes = plane.size, self._passes
        drawn, light = passes.texture("drawn", 2 * size, 2 * size + 1), passes.texture(name, size, size)
        passes.target([drawn]).clear()
        rays = {"rays": passes[f"rays {channel}"], "flux": passes[f"rays {channel} flux"]}
        if plane.method in DIVIDED_AREAS:
            draw_mesh(passes, passes.target([drawn]), rays, plane)
        else:
            self._cells(passes.target([drawn]), rays, plane)
        covariance = plane.detail_covariance
        if covariance is not None:
            folded = passes.texture("folded", size, size)
            passes.fill([folded], "fold", {"light": drawn}, size=size)
            gaussian_blur(passes, light, folded, covariance)
            return light
        radii = plane.disc_radii
        if max(radii) < NO_BLUR_PIXELS:
            passes.fill([light], "fold", {"light": drawn}, size=size)
            return light
        folded = passes.texture("folded", size, size)
        passes.fill([folded], "fold", {"light": drawn}, size=size)
        disc_blur(passes, light, folded, radii)
        return light

    def _cells(self, target: moderngl.Framebuffer, rays: Textures, plane: CausticPlane) -> None:
        """Draw every cell by exact coverage: small ones as points, those beyond the driver's points as rectangles."""
        widest = plane.size - 1.0
        limit = min(self._point_limit, widest)
        common: dict[str, Any] = plane.uniforms | {
            "vertex": "caustics/gl/cell.vert", "mode": moderngl.POINTS, "vertices": plane.grid**2
        }  # fmt: skip
        self._passes.draw(target, "cell", rays, extents=(0.0, limit), **common)
        if limit < widest:
            self._passes.draw(
                target, "cell", rays, geometry="caustics/gl/cell.geom", RECTANGLES=1, extents=(limit, widest), **common
            )
