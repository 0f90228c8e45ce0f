# SPDX-License-Identifier: Apache-2.0
"""Water by what is seen from near and far: of places in solved water, and of the files of a clip."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import mr360uw as uw
from mr360uw.base.color import encode
from mr360uw.base.sphere import directions
from mr360uw.cli import app
from mr360uw.depth.clip_water import LitFrame, seen_places
from mr360uw.depth.sphere_stereo import DepthMap
from mr360uw.errors import ParameterError
from mr360uw.medium import water_by_distance as by_distance
from mr360uw.medium.water_by_distance import SeenPlaces, water_by_distance
from tests.depth import tolerances
from tests.depth.hazy_scene import HazyScene
from tests.depth.own_maps import write_own_maps
from tests.depth.test_clip_depth import write_track
from tests.depth.wet_dive import DEPTH_M, WetDive, medium

GAIN = np.array([1.6, 1.1, 0.9])
WIDTH, FRAMES, SECONDS = 256, 8, 8.0
DIVE = WetDive(3, "3C", 0.5, width=WIDTH)


def places(
    kind: str, *, farther: float = 2.2, caustics: float = 0.1, count: int = 150
) -> tuple[SeenPlaces, np.ndarray]:
    """Return places in a type of water, from distances up to a factor, and the true attenuation and veil (2, 3)."""
    r = np.random.default_rng(5)
    lit = medium(kind)  # type: ignore[arg-type]
    near, frames = r.uniform(1.5, 4.0, (count, 1)), 16
    distance = near * np.linspace(1.0, farther, frames)
    up = np.clip(r.uniform(-0.6, 0.2, (count, 1)) + r.normal(0.0, 0.03, distance.shape), -0.8, 0.3)
    own = r.uniform(0.02, 0.5, (count, 1, 1)) * lit.irradiance(DEPTH_M) / np.pi
    change = np.exp(caustics * r.standard_normal(distance.shape))[..., None]
    veil = lit.veil(distance, DEPTH_M, up)
    light = GAIN * (own * change * lit.transmittance(distance, DEPTH_M, 0.0 * up) + veil)
    above = np.linspace(0.0, 0.15, 4)
    ends = np.percentile(distance, (10.0, 90.0))
    passed = lit.transmittance(ends, DEPTH_M, 0.0)
    truth = np.array([np.log(passed[0] / passed[1]) / np.ptp(ends), GAIN * lit.veil(1e4, DEPTH_M, 0.0)])
    seen = np.ones(distance.shape, bool)
    part = np.arange(count) // 6
    turn = r.uniform(0.0, 2.0 * np.pi, (count, 1)) + 0.0 * up
    across = np.sqrt(1.0 - up * up)[..., None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    shown = GAIN * lit.radiance(DEPTH_M + 0.0 * above, above)
    return SeenPlaces(light, distance, up, across, seen, part, above, shown), truth


@pytest.fixture(autouse=True)
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(by_distance, "_DRAWS", 4)


@pytest.mark.parametrize("kind", ["II", "5C"])
def test_attenuation_and_veil_of_a_type(kind: str) -> None:
    seen, (c, v) = places(kind)
    found = water_by_distance(seen)
    assert not found.problem
    assert np.all(np.abs(found.attenuation / c - 1.0) < tolerances.ATTENUATION)
    assert np.all(np.abs(found.veil / v - 1.0) < tolerances.VEIL)
    assert np.all((found.attenuation_low < found.attenuation) & (found.attenuation < found.attenuation_high))
    sight = uw.medium.closed_form.visibility_m(uw.medium.Water.jerlov(kind))  # type: ignore[arg-type]
    assert abs(found.visibility_m / sight - 1.0) < tolerances.ATTENUATION
    assert found.overrides[1] == f"water.visibility_m={found.visibility_m:.3g}"
    assert "green  attenuation" in str(found)


@pytest.mark.parametrize(("slope", "side"), [(0.0, 0.0), (1.0, 0.0), (0.5, 0.6)])
def test_attenuation_and_veil_of_plain_haze(slope: float, side: float) -> None:
    """Koschmieder's haze, whose veil fills up as fast as things fade, in all directions; solved water is unlike it.

    side: whether it is brighter on one side, as towards the sun.
    """
    seen, _ = places("II", caustics=0.05)
    c, v = np.array([0.3, 0.12, 0.09]), np.array([0.03, 0.12, 0.2])
    own = np.random.default_rng(6).uniform(0.02, 0.6, (len(seen.part), 1, 1))
    left = np.exp(-seen.distance_m[..., None] * c)
    light = own * left + v * np.exp(slope * seen.up + side * seen.across[..., 0])[..., None] * (1.0 - left)
    light *= np.exp(0.05 * np.random.default_rng(7).standard_normal(left.shape[:2]))[..., None]
    found = water_by_distance(replace(seen, light=light, open_light=v * np.exp(slope * seen.open_up)[:, None]))
    assert not found.problem
    assert np.all(np.abs(found.attenuation / c - 1.0) < 0.06)  # of some places in 16 frames that differ by 5 %
    assert np.all(np.abs(found.veil / v - 1.0) < 0.04)


def test_a_clip_that_does_not_tell_says_so() -> None:
    still = water_by_distance(places("1C", farther=1.1)[0])
    assert "vary enough, by 1.10 at the median" in still.problem
    assert still.overrides == []
    assert "does not tell its water" in str(still)
    assert not any(word in str(still).lower() for word in ("nan", "type", "jerlov", "attenuation"))
    assert still.water_type is None
    wild = water_by_distance(places("IB", farther=1.3, caustics=1.2, count=80)[0])
    assert "uncertain by more than a factor" in wild.problem
    assert "nearest type" not in str(wild)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip of a dive with its maps and its track."""
    folder = tmp_path_factory.mktemp("water")
    frames = DIVE.frames(SECONDS, FRAMES)
    for k, frame in enumerate(frames):
        codes = np.round(255.0 * encode(frame.image, "srgb")).astype(np.uint8)
        cv2.imwrite(str(folder / f"plate_{k:04d}.png"), codes[..., ::-1])
    write_own_maps(folder / "depth", {k: (frame.found,) for k, frame in enumerate(frames)})
    write_track(folder / "track.csv", [DIVE.scene.pose(t) for t in np.linspace(0.0, SECONDS, FRAMES)])
    return folder


def test_the_files_of_a_clip_tell_its_water(clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mr360uw.depth.clip_depth.LEAST_WIDTH", WIDTH)
    monkeypatch.setattr("mr360uw.depth.clip_depth._inputs", lambda *_: {"made_from": "a test"})
    found: list[by_distance.WaterByDistance] = []
    monkeypatch.setattr(
        "mr360uw.depth.clip_water.water_by_distance", lambda seen: found.append(water_by_distance(seen)) or found[-1]
    )
    options = ["-o", str(clip / "depth"), "--width", str(WIDTH), "--water"]
    command = ["depth", str(clip / "plate_%04d.png"), *options]
    assert "--track" in str(CliRunner().invoke(app, command).exception)
    done = CliRunner().invoke(app, [*command, "--track", str(clip / "track.csv")])
    assert done.exit_code == 0, done.output
    assert f"{FRAMES} kept" in done.output
    assert str(found[0]) in done.output
    assert f"--set water.visibility_m={found[0].visibility_m:.3g}" in done.output
    c = -np.log(medium(DIVE.kind).transmittance(4.0, DEPTH_M, 0.0)) / 4.0
    assert np.all(np.abs(found[0].attenuation / c - 1.0) < tolerances.ATTENUATION_OF_FEW)


def test_a_clip_that_is_too_short_is_refused(clip: Path) -> None:
    write_track(clip / "short.csv", [DIVE.scene.pose(t) for t in (0.0, 1.0, 2.0)])
    with pytest.raises(ParameterError, match="too short"):
        uw.depth.water_of_clip(clip / "plate_%04d.png", clip / "depth", clip / "short.csv")


def test_places_are_where_they_are_seen() -> None:
    """The light of a place is that of its own point, and what is hidden by something nearer is not seen."""
    frames = []
    scene = HazyScene(seed=4, caustics=0.0, particles=0, noise=0.0, haze=np.zeros(3))
    for t in (0.0, 3.0, 6.0):
        light, distance, _ = scene.see(WIDTH, t, samples=2)
        found = DepthMap(distance.astype(np.float32), np.isfinite(distance).astype(np.float32))
        frames.append(LitFrame(light.astype(np.float32), found, *scene.pose(t)))
    seen = seen_places(frames)
    both = seen.seen[:, 0] & seen.seen[:, 1]
    assert both.sum() > 100
    apart = seen.light[both, 0, 1] / seen.light[both, 1, 1] - 1.0
    assert np.median(np.abs(apart)) < tolerances.SAME_PLACE
    assert not seen.seen[:, 1:].all()


def test_dark_things_of_unsure_distance_are_no_open_water() -> None:
    """Even water over a sure floor, and between them a band of shade whose distance is not sure."""
    up = np.repeat(directions(WIDTH, WIDTH // 2)[..., 1:2], 3, axis=-1)
    water = np.array([0.02, 0.2, 0.3]) * np.exp(1.4 * up)
    light = np.where(up < -0.05, np.array([0.5, 0.3, 0.25]) * water, water).astype(np.float32)
    sure = (up[..., 0] < -0.4).astype(np.float32)
    far = np.where(sure > 0.0, -1.6 / up[..., 0], 4.0).astype(np.float32)
    frames = [LitFrame(light, DepthMap(far, sure), np.array([0.3 * k, 0.0, 0.0]), np.eye(3)) for k in range(3)]
    seen = seen_places(frames)
    assert len(seen.open_up) > 5
    assert seen.open_up.min() > -0.05
    assert np.allclose(seen.open_light, np.array([0.02, 0.2, 0.3]) * np.exp(1.4 * seen.open_up)[:, None], rtol=0.05)
