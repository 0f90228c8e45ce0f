# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from mr360uw.base.constants import REFRACTIVE_INDEX_SEA
from mr360uw.base.sphere import basis, directions, disc_directions, disc_offsets, effective_half_angle, unit
from mr360uw.composite.gl.device import list_texture, upload_mesh
from mr360uw.composite.mesh.material import (
    WRAPS,
    Material,
    Texture,
    alpha_at,
    make_texture,
    texture_lookup,
    texture_taps,
    trilinear,
)
from mr360uw.composite.reference import render_aovs
from mr360uw.composite.shading import (
    dielectric_f0,
    ggx_distribution,
    highlight,
    lobe_axis,
    reflectance,
    smith_visibility,
)
from mr360uw.ibl.lighting import environment as sky_light
from tests.composite import tolerances as tol
from tests.composite.scenes import placed, quad, shot, sphere
from tests.glsl import glsl_call

COUNT = 2000


def test_facets_cover_the_plane_once() -> None:
    cosine = (np.arange(200_000) + 0.5) / 200_000
    for alpha in (0.05, 0.3, 1.0):
        total = 2.0 * np.pi * np.mean(ggx_distribution(cosine, np.float64(alpha)) * cosine)
        np.testing.assert_allclose(total, 1.0, rtol=tol.QUADRATURE)


@pytest.mark.parametrize("half_angle", [0.00465, 0.03, 0.1])
@pytest.mark.parametrize("alpha", [0.04, 0.16, 0.4])
def test_the_disc_of_a_light_widens_its_highlight(alpha: float, half_angle: float) -> None:
    """A highlight is the mean of those of all points of the light's disc, which is integrated here ring by ring."""
    edge = half_angle * np.linspace(0.0, 1.0, 201) ** 2  # dense about the middle, where the lobe may be narrow
    ring = np.repeat(-np.diff(np.cos(edge)) / (1.0 - np.cos(half_angle)) / 64, 64)
    polar, turn = np.repeat(0.5 * (edge[1:] + edge[:-1]), 64)[:, None], np.tile(2.0 * np.pi * np.arange(64) / 64, 200)
    for incidence in np.radians([0.0, 30.0, 55.0]):
        view = np.array([np.sin(incidence), 0.0, np.cos(incidence)])
        across, along, mirror = basis(view * [-1.0, 1.0, 1.0])
        found, expected = [], []
        for off in np.array([0.0, 0.5, 1.0, 2.0]) * 2.0 * np.hypot(alpha, 0.5 * half_angle):
            for direction in (across, -across, along):
                middle = unit(mirror + off * direction)
                u, v, _ = basis(middle)
                disc = np.sin(polar) * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v) + np.cos(polar) * middle
                if middle[2] > np.sin(2.0 * half_angle):
                    found.append(lit_by(alpha, view, middle[None], half_angle)[0])
                    expected.append(ring @ lit_by(alpha, view, disc, 0.0))
        assert found[0] == pytest.approx(expected[0], rel=tol.DISC_PEAK)
        assert np.sqrt(np.mean(np.subtract(found, expected) ** 2)) < tol.DISC_LOBE * expected[0]


def lit_by(alpha: float, view: np.ndarray, light: np.ndarray, half_angle: float) -> np.ndarray:
    """Return the highlight (n,) of a surface about +z that reflects light (n, 3) perfectly."""
    half = unit(light + view)
    n_dot_v, one = np.full(len(light), view[2]), np.ones((len(light), 3))
    given = np.full(len(light), alpha), n_dot_v, light[:, 2], half[:, 2], half @ view
    return highlight(one, *given, half_angle)[:, 0]


def coat_lobe(roughness: float, view: np.ndarray, count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Return directions (m, 3) that a GGX coat about +z reflects to `view`, and their weights (m,): f cos / density.

    Half vectors spread as the distribution times the cosine; masking as in the module, no Fresnel term.
    """
    alpha = roughness * roughness
    u = (np.arange(count) + 0.5) / count
    cos_h = np.sqrt((1.0 - u) / (1.0 + (alpha * alpha - 1.0) * u))[:, None]
    sin_h, phi = np.sqrt(1.0 - cos_h**2), 2.0 * np.pi * u
    half = np.stack(np.broadcast_arrays(sin_h * np.cos(phi), sin_h * np.sin(phi), cos_h), axis=-1).reshape(-1, 3)
    v_dot_h = half @ view
    light = 2.0 * v_dot_h[:, None] * half - view
    lit = (light[:, 2] > 0.0) & (v_dot_h > 0.0)
    n_dot_l = np.where(lit, light[:, 2], 1.0)
    weight = smith_visibility(view[2], n_dot_l, np.float64(alpha)) * 4.0 * v_dot_h * n_dot_l / half[:, 2]
    return light, np.where(lit, weight, 0.0) / len(half)


def test_the_lobe_leans_from_the_mirror_to_the_normal() -> None:
    up = np.array([0.0, 0.0, 1.0])
    error = []
    for roughness in np.linspace(0.1, 1.0, 10):
        for n_dot_v in (0.1, 0.3, 0.5, 0.7, 0.9):
            view = np.array([np.sqrt(1.0 - n_dot_v**2), 0.0, n_dot_v])
            light, weight = coat_lobe(roughness, view)
            axis = lobe_axis(up[None], view[None], np.array([n_dot_v]), np.array([roughness]))[0]
            error.append(np.degrees(np.arccos(np.clip(axis @ unit(weight @ light), -1.0, 1.0))))
    assert np.sqrt(np.mean(np.square(error))) < tol.LOBE_AXIS_DEG
    mirror, rough = lobe_axis(up, view, np.full(2, n_dot_v), np.array([0.0, 1.0]))
    np.testing.assert_allclose(mirror, view * [-1, 1, 1], atol=tol.FLOAT64)
    np.testing.assert_allclose(rough, up, atol=tol.FLOAT64)


def test_rough_metal_in_light_from_one_side() -> None:
    """White metal whose right half of the sky shines, with the light of all bounces: int f cos L / int f cos."""
    sky = np.where(directions(256, 128)[..., :1] > 0.0, 1.0, 0.0) * np.ones(3)
    light = sky_light(sky.astype(np.float32), expansion="none", sun=None, glossy=True)
    ball = placed(sphere(32, Material(base_color=(1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=0.9)), (0.0, 0.0, -2.0))
    layer, variables = render_aovs(shot(ball, width=128, sun=None, environment=light))
    seen = np.argwhere(layer.alpha > 0.999)[::4]
    got, expected = [], []
    for j, i in seen:
        normal, view = variables.normal[j, i].astype(float), -unit(variables.position[j, i])
        frame = basis(normal)
        reflected, weight = coat_lobe(0.9, frame @ view, 64)
        expected.append(weight @ ((reflected @ frame)[:, 0] > 0.0) / weight.sum())
        got.append(variables.glossy[j, i, 0])
    assert np.sqrt(np.mean((np.array(got) - expected) ** 2)) < tol.ONE_SIDED_METAL


def test_water_takes_most_of_a_coats_reflection() -> None:
    in_air, in_water = dielectric_f0(1.5, 1.0), dielectric_f0(1.5, REFRACTIVE_INDEX_SEA)
    assert in_air == pytest.approx(0.04)
    assert 10.0 < in_air / in_water < 15.0


def test_white_metal_reflects_everything() -> None:
    split = np.array([[0.6, 0.1], [0.9, 0.05], [0.2, 0.3]])
    np.testing.assert_allclose(reflectance(np.ones((3, 3)), split), 1.0, atol=tol.FLOAT64)
    assert np.all(reflectance(np.zeros((3, 3)), split) == 0.0)  # a body of water in water


def test_the_suns_disc_is_filled_evenly() -> None:
    offsets = disc_offsets(256)
    np.testing.assert_allclose(offsets.mean(axis=0), 0.0, atol=tol.ALPHA)
    np.testing.assert_allclose(np.mean(offsets**2), 0.25, rtol=tol.QUADRATURE)
    axis = unit([0.2, 0.9, 0.1])
    angle = np.arccos(np.clip(disc_directions(axis, 0.05, 64) @ axis, -1, 1))
    assert angle.max() <= 0.05
    np.testing.assert_allclose(disc_directions(axis, 0.05, 1)[0], axis, atol=tol.FLOAT64)
    for direction in ([0, 0, 1], [0, 0, -1], [0, 1, 0], axis):
        np.testing.assert_allclose(basis(direction) @ basis(direction).T, np.eye(3), atol=tol.FLOAT64)
    assert effective_half_angle(0.03, 0.02) == pytest.approx(0.05)


def test_mips_keep_the_mean_and_clear_texels_do_not_bleed(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (32, 64, 3), dtype=np.uint8)
    texture = make_texture(image, srgb=True)
    assert [level.shape[:2] for level in texture.levels] == [
        (32, 64),
        (16, 32),
        (8, 16),
        (4, 8),
        (2, 4),
        (1, 2),
        (1, 1),
    ]
    for level in texture.levels:
        np.testing.assert_allclose(level.mean(axis=(0, 1)), texture.levels[0].mean(axis=(0, 1)), atol=tol.HALF_FLOAT)
    clear = np.zeros((8, 8, 4), np.uint8)
    clear[:, ::2] = (255, 255, 255, 255)
    small = make_texture(clear, srgb=True).levels[1]
    np.testing.assert_allclose(small[..., :3], 1.0, atol=tol.HALF_FLOAT)
    np.testing.assert_allclose(small[..., 3], 0.5, atol=tol.HALF_FLOAT)


def test_lookups_at_texel_centres_and_wraps() -> None:
    image = np.zeros((4, 4, 3), np.uint8)
    image[1, 2] = 255
    uv = np.array([[2.5, 1.5]]) / 4
    for wrap, away in (("repeat", uv + np.array([1, -2])), ("clamp", uv), ("mirror", 2.0 - uv)):
        texture = make_texture(image, srgb=False, wrap=(wrap, wrap))
        np.testing.assert_allclose(trilinear(texture, away, np.zeros(1))[0, :3], 1.0, atol=tol.HALF_FLOAT)


def test_a_long_footprint_is_looked_up_several_times_at_the_level_of_its_width() -> None:
    texture = make_texture(np.zeros((64, 64, 3), np.uint8), srgb=False)
    turn = np.array([[np.cos(0.4), np.sin(0.4)], [-np.sin(0.4), np.cos(0.4)]])
    # half axes of 2 and 6 texels, whichever way the ellipse lies on the map and the pixel's axes lie in it
    for axes in (np.eye(2), turn):
        du, dv = (axes @ np.diag([2.0, 6.0]) @ turn) / 64
        level, count, offset = texture_taps(texture, du, dv)
        assert level == pytest.approx(1.0)
        assert count == 5
        assert np.linalg.norm(offset) * 64 == pytest.approx(4.0)
        assert abs(offset @ turn[1]) * 64 == pytest.approx(4.0)
    assert texture_taps(texture, np.array([0.1, 0.0]), np.array([0.0, 0.1]))[1] == 1


def test_thin_lines_at_a_grazing_angle_are_as_dark_at_every_pixel() -> None:
    image = np.full((256, 256, 3), 255, np.uint8)
    image[:, 128] = 0
    texture = make_texture(image, srgb=False)
    # pixels of 16 x 2 texels, moved along the longer axis by less than a pixel: a box would read 1/16 of the line
    uv = np.stack([(128.5 + np.linspace(-7.0, 7.0, 29)) / 256, np.full(29, 0.5)], -1)
    read = texture_lookup(texture, uv, np.tile([8.0 / 256, 0.0], (29, 1)), np.tile([0.0, 1.0 / 256], (29, 1)))[:, 0]
    inside = np.abs(uv[:, 0] * 256 - 128.5) < 6.0
    np.testing.assert_allclose(1.0 - read[inside], 1.0 / 16, atol=0.03)  # 8 lookups, each with a tent of 2 texels


def test_alpha_that_is_compiled_is_the_textures(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (16, 40, 4), dtype=np.uint8)
    uv, change = rng.uniform(-2, 3, (COUNT, 2)), rng.uniform(-0.2, 0.2, (COUNT, 2, 2))
    for wrap in (("repeat", "clamp"), ("mirror", "repeat")):
        texture = make_texture(image, srgb=True, wrap=wrap)
        alphas = np.concatenate([[0.0], *(level[..., 3].ravel() for level in texture.levels)]).astype(np.float32)
        place = np.array([1, *texture.size, *(WRAPS.index(one) for one in wrap)])
        got = [alpha_at(alphas, place, *at, beside) for at, beside in zip(uv, change, strict=True)]
        expected = texture_lookup(texture, uv, change[:, 0], change[:, 1])[:, 3]
        np.testing.assert_allclose(got, expected, atol=tol.HALF_FLOAT)


@pytest.mark.usefixtures("gl")
def test_texture_lookup_on_the_device_is_the_references(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (16, 40, 4), dtype=np.uint8)
    uv = rng.uniform(-2, 3, (COUNT, 2)).astype(np.float32)
    change = rng.uniform(0, 0.2, (COUNT, 2)).astype(np.float32)
    for wrap in (("repeat", "clamp"), ("mirror", "repeat")):
        texture: Texture = make_texture(image, srgb=True, wrap=wrap)
        textures, _ = upload_mesh(quad(Material(base_map=texture)))
        got = glsl_call(
            "composite/gl/shaders/texture.glsl",
            "texture_lookup(store, texelFetch(materials, ivec2(3, 0), 0), uv, vec2(c.x, 0.0), vec2(0.0, c.y))",
            4, "uniform sampler2D store, materials;", {name: textures[name] for name in ("store", "materials")},
            uv=uv, c=change,
        )  # fmt: skip
        du, dv = np.zeros((COUNT, 2)), np.zeros((COUNT, 2))
        du[:, 0], dv[:, 1] = change[:, 0], change[:, 1]
        expected = texture_lookup(texture, uv, du, dv)
        np.testing.assert_allclose(got, expected, atol=tol.TEXTURE_TWIN)


@pytest.mark.usefixtures("gl")
def test_lists_are_read_where_they_were_written(rng: np.random.Generator) -> None:
    values = rng.uniform(size=(5000, 4)).astype(np.float32)
    index = rng.integers(0, 5000, COUNT)
    got = glsl_call(
        "composite/gl/shaders/geometry.glsl", "listed(list, int(i))", 4, "uniform sampler2D list;",
        {"list": list_texture(values)}, i=index.astype(np.float32),
    )  # fmt: skip
    assert np.array_equal(got, values[index])
