# SPDX-License-Identifier: Apache-2.0
"""Whole frames and videos through the public calls."""

from __future__ import annotations

from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.sample import SampleDive
from mr360uw.scene.model import load_scene
from mr360uw.video import container, read_spherical
from tests.gpmf import payloads, tilted_up
from tests.scenes import gradient_plate, yawed
from tests.scenes import scene_with as exact_scene_with
from tests.tolerances import (
    AGREEMENT_CODE,
    AGREEMENT_FRACTION,
    AGREEMENT_PSNR_DB,
    FLOAT64,
    FRAME_ALONE_CODES,
    FRAME_ALONE_FRACTION,
    GRAVITY_RAD,
    HALF_FLOAT,
    ROLL_CODE,
    ROLL_FRACTION,
    SUN_PLACE,
)
from tests.video.clips import write_clip, write_trimmed_clip

scene_with = partial(exact_scene_with, rough=True)
"""What is asserted of whole frames does not depend on how light about the sun is computed."""


def codes(linear: np.ndarray) -> np.ndarray:
    """Return 8-bit code values, not rounded."""
    from mr360uw.base.color import encode

    return 255.0 * encode(np.clip(linear, 0.0, 1.0).astype(np.float64), "srgb")


def frames_of(path: Path) -> list:
    with uw.open_video(path) as video:
        return list(video.frames())


def audio_packets(path: Path) -> list[tuple[int | None, bytes]]:
    import av

    with av.open(str(path)) as container:
        return [(p.pts, bytes(p)) for p in container.demux(audio=0) if p.size]


def test_a_video_goes_in_and_a_video_comes_out(dive: SampleDive, tmp_path: Path, backend: str) -> None:
    out = tmp_path / "out.mp4"
    seen: list[tuple[int, int | None]] = []
    scene = load_scene(dive.scene)
    report = uw.composite_video(scene, out, backend=backend, progress=lambda *now: seen.append(now), fresh=True)
    plate, made = frames_of(dive.plate), frames_of(out)
    assert report.frames == len(plate) == len(made) == 8
    assert seen == 2 * [(k, 8) for k in range(1, 9)]  # the sun is looked for in a pass of its own
    assert [f.time_s for f in made] == [f.time_s for f in plate]
    assert audio_packets(out) == audio_packets(dive.plate)
    metadata = read_spherical(out)
    assert metadata is not None
    assert metadata.projection == "equirectangular"
    assert metadata.source == "V1+V2"
    assert [p.name for p in tmp_path.iterdir()] == ["out.mp4"]
    # something was put in, and not everywhere
    changed = np.abs(made[3].image_linear - plate[3].image_linear).max(axis=-1) > 0.02
    assert 0.005 < changed.mean() < 0.3


def test_a_short_clip_is_opened_for_its_metadata_and_decoded_once(
    dive: SampleDive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever is measured in it: the sun, the gain, its softness, and whether it is a panorama at all."""
    opened: list[Path] = []
    plain = container.open_container

    def counted(path: Path, *given: Any) -> Any:
        opened.append(path)
        return plain(path, *given)

    monkeypatch.setattr(container, "open_container", counted)
    scene = load_scene(dive.scene, ["draw.samples=1", "object.0.casts_shadow=false"])
    uw.composite_video(scene, tmp_path / "out.mp4", backend="reference", fresh=True)
    assert opened == [dive.plate, dive.plate]


def test_without_an_object_a_lossless_output_is_the_plate(dive: SampleDive, tmp_path: Path) -> None:
    scene = load_scene(dive.scene, ["object=[]", "output.quality=lossless"])
    report = uw.composite_video(scene, tmp_path / "out.mp4")
    assert not report.plan.layer.runs
    for a, b in zip(frames_of(dive.plate), frames_of(tmp_path / "out.mp4"), strict=True):
        for plane in ("y", "u", "v"):
            np.testing.assert_array_equal(getattr(a.yuv, plane), getattr(b.yuv, plane))


def test_pixels_that_nothing_touches_keep_every_bit(dive: SampleDive, tmp_path: Path, backend: str) -> None:
    scene = load_scene(dive.scene, ["output.quality=lossless"])
    uw.composite_video(scene, tmp_path / "out.mp4", frames=(0, 1), backend=backend)
    (made,), plate = frames_of(tmp_path / "out.mp4"), frames_of(dive.plate)[0]
    layer = uw.render_frame(plate.image_linear, scene, plate.time_s, backend).layer
    touched = (layer.alpha > 0) | np.any((layer.ratio != 1) | (layer.shafts != 0), axis=-1)
    assert 0.0 < touched.mean() < 0.5
    np.testing.assert_array_equal(made.yuv.y[~touched], plate.yuv.y[~touched])
    blocks = touched.reshape(touched.shape[0] // 2, 2, -1, 2).any(axis=(1, 3))
    # chroma is interpolated between blocks, so a touched block reaches one sample further
    near = blocks | np.roll(blocks, 1, 1) | np.roll(blocks, -1, 1)
    near = near | np.vstack([near[1:], near[-1:]]) | np.vstack([near[:1], near[:-1]])
    np.testing.assert_array_equal(made.yuv.u[~near], plate.yuv.u[~near])


def test_frame_k_is_the_same_alone_and_in_the_clip(dive: SampleDive, tmp_path: Path, backend: str) -> None:
    scene = load_scene(dive.scene, ["output.quality=lossless"])
    uw.composite_video(scene, tmp_path / "four.mp4", frames=(3, 7), backend=backend)
    uw.composite_video(scene, tmp_path / "one.mp4", frames=(5, 6), backend=backend)
    np.testing.assert_array_equal(frames_of(tmp_path / "four.mp4")[2].yuv.y, frames_of(tmp_path / "one.mp4")[0].yuv.y)


@pytest.mark.parametrize(
    "tables",
    [
        {"water": {"type": "II"}, "receiver": {"height_m": -1.2}},
        {"water": {"type": "none"}, "object": "high"},
        {"water": {"type": "5C"}, "camera": {"depth_m": 9.0}, "object": "seam"},
    ],
    ids=["shadow", "air, zenith", "coast, seam"],
)
@pytest.mark.usefixtures("gl")
def test_the_renderers_agree(tables: dict, whale: Path, tmp_path: Path) -> None:
    places = {"high": [0.1, 3.0, -0.3], "seam": [0.2, -0.3, 3.0]}
    if "object" in tables:
        tables = {**tables, "object": [{"mesh": str(whale), "position_m": places[tables["object"]]}]}
    scene = scene_with(tmp_path, whale, **tables)
    plate = gradient_plate(512, 256)
    made = {name: uw.render_frame(plate, scene, 1.25, name) for name in ("reference", "gl")}
    assert made["reference"].layer.alpha.max() > 0.99
    difference = codes(made["gl"].image_linear) - codes(made["reference"].image_linear)
    psnr = 10.0 * np.log10(255.0**2 / np.mean(difference**2))
    assert psnr >= AGREEMENT_PSNR_DB
    assert np.mean(np.abs(difference) <= AGREEMENT_CODE) >= AGREEMENT_FRACTION


def test_turning_plate_and_scene_rolls_the_result(whale: Path, tmp_path: Path, backend: str) -> None:
    width, yaw = 360, 137.0
    shift = round(width * yaw / 360.0)
    objects = [{"mesh": str(whale), "position_m": [0.4, -0.3, -2.6], "rotation_deg": [35.0, 0.0, 0.0]}]
    still = {"caustics": {"enabled": False}, "receiver": {"height_m": -1.5}}  # waves have a direction of their own
    plate = gradient_plate(width, width // 2)
    a = uw.render_frame(plate, scene_with(tmp_path, None, object=objects, **still), 0.0, backend)
    b = uw.render_frame(
        np.roll(plate, shift, axis=1), scene_with(tmp_path, None, object=yawed(objects, yaw), **still), 0.0, backend
    )
    difference = np.abs(codes(b.image_linear) - codes(np.roll(a.image_linear, shift, axis=1)))
    assert a.layer.alpha.max() > 0.99
    assert np.mean(difference <= ROLL_CODE) >= ROLL_FRACTION


def test_a_frame_range_starts_where_it_says(dive: SampleDive, tmp_path: Path) -> None:
    report = uw.composite_video(load_scene(dive.scene), tmp_path / "out.mp4", frames=(2, 5), backend="reference")
    assert report.frames == len(frames_of(tmp_path / "out.mp4")) == 3


def test_images_come_out_numbered_like_the_frames(dive: SampleDive, tmp_path: Path) -> None:
    uw.composite_video(load_scene(dive.scene), tmp_path / "out_%04d.png", frames=(2, 4), backend="reference")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out_0002.png", "out_0003.png"]


@pytest.mark.parametrize(
    "plate",
    [np.zeros((64, 64, 3)), np.zeros((63, 126, 3)), np.full((64, 128, 3), np.nan), np.zeros((64, 128, 3), np.uint8)],
    ids=["not 2:1", "odd", "NaN", "codes"],
)
def test_a_plate_that_is_none_is_refused(plate: np.ndarray, whale: Path, tmp_path: Path) -> None:
    with pytest.raises(uw.ParameterError, match="plate"):
        uw.render_frame(plate, scene_with(tmp_path, whale), 0.0, "reference")


def test_a_frame_rate_is_kept(dive: SampleDive, tmp_path: Path) -> None:
    uw.composite_video(load_scene(dive.scene), tmp_path / "out.mkv", frames=(0, 4), backend="reference")
    with uw.open_video(tmp_path / "out.mkv") as video:
        assert abs(video.frame_rate - Fraction(24)) < Fraction(1, 10)


@pytest.mark.parametrize(
    ("light", "expected"),
    [
        ({"sun": "none"}, None),
        ({"sun": "given", "sun_azimuth_deg": 90.0, "sun_elevation_deg": 60.0}, [0.5, 0.866, 0.0]),
        # noon at the spring equinox on the equator: the sun stands at the zenith, above the water and below
        ({"sun": "date", "sun_time": "2026-03-20T12:07:00+00:00"}, [0.0, 1.0, 0.0]),
    ],
    ids=["none", "given", "date"],
)
def test_the_sun_is_where_the_scene_says(
    light: dict, expected: list[float] | None, whale: Path, tmp_path: Path
) -> None:
    frame = uw.render_frame(gradient_plate(128, 64), scene_with(tmp_path, whale, light=light), 0.0, "reference")
    assert frame.environment is not None
    if expected is None:
        assert frame.environment.sun is None
        assert frame.caustics is None
        return
    assert frame.environment.sun is not None
    np.testing.assert_allclose(frame.environment.sun.direction, expected, atol=SUN_PLACE)
    assert frame.caustics is not None


def test_a_track_is_smooth_editable_and_used(dive: SampleDive, tmp_path: Path) -> None:
    from mr360uw.ibl import load_track
    from mr360uw.preview.pages import analyse_video

    page, table, sheet = analyse_video(dive.plate, tmp_path / "page.html")
    assert "<svg" in page.read_text("utf-8")
    assert "sun at azimuth" in page.read_text("utf-8")
    assert "https://" not in page.read_text("utf-8").replace("https://www.w3.org", "")
    track = load_track(table)
    assert len(track) == 8
    text = sheet.read_text("utf-8")
    edited = tmp_path / "edited.csv"
    rows = [row.split(",") for row in text.splitlines()]
    column = rows[0].index("azimuth_deg")
    edited.write_text(
        "\n".join([",".join(rows[0]), *(",".join([*r[:column], "100.0", *r[column + 1 :]]) for r in rows[1:])])
    )
    scene = load_scene(dive.scene, ['light.sun="detect"', f'light.track="{edited}"'])
    uw.composite_video(scene, tmp_path / "out.mp4", frames=(0, 1), backend="reference")
    assert np.degrees(np.arctan2(*load_track(edited).at(0).direction[[0, 2]] * [1, -1])) == pytest.approx(100.0)
    short = tmp_path / "short.csv"
    short.write_text("\n".join(text.splitlines()[:5]) + "\n")
    with pytest.raises(uw.SceneError, match="another clip"):
        uw.composite_video(
            load_scene(dive.scene, ['light.sun="detect"', f'light.track="{short}"']), tmp_path / "no.mp4"
        )


def test_a_camera_that_turns_sees_the_same_world(whale: Path, tmp_path: Path, backend: str) -> None:
    """A camera turned to the left sees the same as a plate rolled to the right, waves and shadows included."""
    width, yaw = 360, 137.0
    shift = round(width * yaw / 360.0)
    c, s = np.cos(np.radians(yaw / 2)), np.sin(np.radians(yaw / 2))
    (tmp_path / "track.csv").write_text(f"time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,{s},0,{c}\n")
    plate = gradient_plate(width, width // 2)
    still = scene_with(tmp_path, whale, receiver={"height_m": -1.5})
    turning = scene_with(
        tmp_path, whale, receiver={"height_m": -1.5}, camera={"track": str(tmp_path / "track.csv"), "depth_m": 5.0}
    )
    a = uw.render_frame(plate, still, 0.0, backend)
    b = uw.render_frame(np.roll(plate, shift, axis=1), turning, 0.0, backend)
    difference = np.abs(codes(b.image_linear) - codes(np.roll(a.image_linear, shift, axis=1)))
    assert np.mean(difference <= ROLL_CODE) >= ROLL_FRACTION


def test_a_trimmed_clip_keeps_sound_times_and_every_untouched_bit(whale: Path, tmp_path: Path, backend: str) -> None:
    clip, whole = write_trimmed_clip(tmp_path / "clip.mp4", 6, size=(512, 256))
    objects = [{"mesh": str(whale), "position_m": [0.6, 0.0, -2.4], "rotation_deg": [60.0, 0.0, 0.0]}]
    scene = scene_with(
        tmp_path, None, plate=str(clip), water={"type": "none"}, object=objects,
        light={"smooth": False}, output={"quality": "lossless"},
    )  # fmt: skip
    uw.composite_video(scene, tmp_path / "out.mp4", frames=(0, 3), backend=backend)
    with uw.open_video(clip) as video:
        plates = list(video.frames(0, 3))
    made = frames_of(tmp_path / "out.mp4")
    layer = uw.render_frame(plates[0].image_linear, scene, 0.0, backend).layer
    touched = layer.alpha > 0
    assert 0.001 < touched.mean() < 0.05
    for plate, frame, (_, planes) in zip(plates, made, whole[3:6], strict=True):
        assert frame.time_s == plate.time_s
        np.testing.assert_array_equal(plate.yuv.y, planes[0])
        np.testing.assert_array_equal(frame.yuv.y[~touched], plate.yuv.y[~touched])
        assert np.any(frame.yuv.y[touched] != plate.yuv.y[touched])
    copied = [data for _, data in audio_packets(tmp_path / "out.mp4")]
    assert copied == [data for _, data in audio_packets(clip)][: len(copied)]
    assert copied


def test_a_tilted_plate_is_levelled_like_a_camera_that_turned(whale: Path, tmp_path: Path) -> None:
    from scipy.spatial.transform import Rotation

    from mr360uw.ibl.tilt import level_matrix

    q = Rotation.from_matrix(level_matrix(np.radians(12.0), np.radians(-7.0))).as_quat()
    (tmp_path / "tilt.csv").write_text("time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0," + ",".join(map(str, q)) + "\n")
    plate = gradient_plate(256, 128)
    cameras = [
        {"track": str(tmp_path / "tilt.csv")},
        {"roll_deg": 12.0, "pitch_deg": -7.0},
        {"tilt_keys": [[0.0, 12.0, -7.0], [1.0, 0.0, 0.0]]},
    ]
    first, *others = (
        uw.render_frame(plate, scene_with(tmp_path, whale, camera=camera), 0.0, "reference") for camera in cameras
    )
    assert first.layer.alpha.max() > 0.99
    for other in others:
        assert np.mean(np.abs(codes(other.image_linear) - codes(first.image_linear)) <= ROLL_CODE) >= ROLL_FRACTION


def test_a_camera_that_sinks_sees_the_water_of_its_depth(whale: Path, tmp_path: Path) -> None:
    plate = gradient_plate(256, 128)
    whale_at = {"mesh": str(whale), "rotation_deg": [-60.0, 5.0, 0.0]}
    keys = [[0.0, 4.0], [2.0, 7.0]]
    (tmp_path / "down.csv").write_text("time_s,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n2,0,-3,0,0,0,0,1\n")
    sinking = [
        scene_with(tmp_path, None, camera=camera, object=[{**whale_at, "position_m": [0.3, -2.5, -3.0]}])
        for camera in ({"depth_m": 4.0, "depth_keys": keys}, {"depth_m": 4.0, "track": str(tmp_path / "down.csv")})
    ]
    there = scene_with(tmp_path, None, camera={"depth_m": 7.0}, object=[{**whale_at, "position_m": [0.3, 0.5, -3.0]}])
    expected = uw.render_frame(plate, there, 2.0, "reference")
    assert expected.layer.alpha.max() > 0.99
    for scene in sinking:
        found = uw.render_frame(plate, scene, 2.0, "reference")
        assert found.medium is not None
        assert found.medium.camera_depth_m == pytest.approx(7.0)
        near = np.abs(codes(found.image_linear) - codes(expected.image_linear)) <= ROLL_CODE
        assert np.mean(near) >= ROLL_FRACTION
    with pytest.raises(uw.ParameterError, match="leaves the water"):
        uw.render_frame(plate, scene_with(tmp_path, whale, camera={"depth_keys": [[0.0, 1.0], [9.0, -0.2]]}))
    with pytest.raises(uw.SceneError, match="ascend"):
        scene_with(tmp_path, whale, camera={"depth_keys": [[1.0, 1.0], [0.0, 2.0]]})
    with pytest.raises(uw.SceneError, match="got both"):
        scene_with(tmp_path, whale, camera={"depth_keys": keys, "track": str(tmp_path / "down.csv")})


def test_a_gopro_clip_levels_the_plate(whale: Path, tmp_path: Path) -> None:
    from mr360uw.render.surroundings import level_track

    roll, pitch = 0.3 * np.sin(0.2 * np.arange(30)), 0.2 * np.cos(0.3 * np.arange(30))
    clip = write_clip(tmp_path / "camera.mp4", 30, camera_data=payloads(tilted_up(roll, pitch), (25, 5)))
    plate = write_clip(tmp_path / "stitched.mp4", 30)
    track = level_track(scene_with(tmp_path, whale, plate=str(plate), camera={"gravity": str(clip)}))
    assert track is not None
    np.testing.assert_allclose(track[:, 0], np.arange(30) / 25.0, atol=FLOAT64)
    np.testing.assert_allclose(track[:, 1:].T, (roll, pitch), atol=GRAVITY_RAD)
    with pytest.raises(uw.VideoError, match="GoPro"):
        level_track(scene_with(tmp_path, whale, plate=str(plate), camera={"gravity": str(plate)}))


def test_layers_come_out_as_multi_part_exr_and_recombine(dive: SampleDive, tmp_path: Path, backend: str) -> None:
    from mr360uw.base.color import XY_BY_NAME
    from mr360uw.video import read_exr
    from mr360uw.video.exr import read_frame

    scene = load_scene(dive.scene, ["light.smooth=false"])
    pattern = tmp_path / "layers_%04d.exr"
    uw.composite_video(scene, tmp_path / "out.mp4", frames=(0, 2), backend=backend, layers=pattern)
    assert sorted(p.name for p in tmp_path.glob("*.exr")) == ["layers_0000.exr", "layers_0001.exr"]
    parts = read_exr(tmp_path / "layers_0000.exr")
    names = ["rgba", "depth", "N", "P", "id", "forward", "backward", "diffuse", "glossy", "sun", "lamps", "caustics",
             "emission", "veil", "shafts", "snow", "transmittance", "shadow_ratio", "plate_shafts",
             "receiver_difference"]  # fmt: skip
    mattes = [f"Crypto{kind}{k:02d}" for kind in ("Object", "Material") for k in range(3)]
    assert list(parts) == names + mattes
    part = {name: np.asarray(next(iter(parts[name].values())), np.float64) for name in names}
    plate = frames_of(dive.plate)[0].image_linear
    alpha = part["rgba"][..., 3:]
    total = sum(part[name][..., :3] for name in ("diffuse", "glossy", "sun", "emission", "veil", "shafts", "snow"))
    np.testing.assert_allclose(total, part["rgba"][..., :3], atol=HALF_FLOAT)
    composite = part["rgba"][..., :3] + (1.0 - alpha) * (plate + part["receiver_difference"][..., :3])
    expected = codes(uw.render_frame(plate, scene, 0.0, backend).image_linear)
    assert np.mean(np.abs(codes(composite) - expected) <= FRAME_ALONE_CODES) >= FRAME_ALONE_FRACTION
    in_acescg = load_scene(dive.scene, ["light.smooth=false", "output.layers=ap1"])
    uw.composite_video(
        in_acescg, tmp_path / "aces.mp4", frames=(0, 1), backend=backend, layers=tmp_path / "aces_%d.exr"
    )
    light, chromaticities, *_ = read_frame(tmp_path / "aces_0.exr")
    np.testing.assert_allclose(chromaticities, XY_BY_NAME["ap1"], atol=1e-6)
    assert np.abs(light - part["rgba"][..., :3]).max() > 1e-3
    (tmp_path / "layers_0000.exr").unlink()
    with pytest.raises(uw.OutputExistsError, match="layers_0001"):
        uw.composite_video(scene, tmp_path / "again.mp4", frames=(0, 2), backend=backend, layers=pattern)
    with pytest.raises(uw.ParameterError, match="numbered"):
        uw.composite_video(scene, tmp_path / "again.mp4", frames=(0, 2), layers=tmp_path / "layers.exr")
    assert not list(tmp_path.glob("again*"))
    assert not (tmp_path / "layers_0000.exr").exists()


def test_layers_do_not_change_the_picture(dive: SampleDive, tmp_path: Path) -> None:
    keys = ["object.0.key=[{time_s=0.0}, {time_s=0.5, position_m=[1.4, -0.6, -3.6]}]"]
    scene = load_scene(dive.scene, [*keys, "draw.motion_samples=4", "light.smooth=false"])
    folders = [tmp_path / "with", tmp_path / "without"]
    for folder, layers in zip(folders, (folders[0] / "layers_%04d.exr", None), strict=True):
        folder.mkdir()
        uw.composite_video(scene, folder / "out_%02d.png", frames=(3, 4), backend="reference", layers=layers)
    assert (folders[0] / "out_03.png").read_bytes() == (folders[1] / "out_03.png").read_bytes()
    still = load_scene(dive.scene, [*keys, "light.smooth=false"])
    uw.composite_video(still, tmp_path / "sharp_%02d.png", frames=(3, 4), backend="reference")
    assert (tmp_path / "sharp_03.png").read_bytes() != (folders[0] / "out_03.png").read_bytes()


def test_a_frame_alone_is_the_video_s_with_the_clip_s_track(dive: SampleDive, tmp_path: Path) -> None:
    from mr360uw.render.first_pass import first_pass
    from mr360uw.render.surroundings import load_surroundings

    scene = load_scene(dive.scene)
    uw.composite_video(scene, tmp_path / "out_%02d.exr", frames=(2, 3), backend="reference")
    with uw.open_video(dive.plate) as video:
        track = first_pass(load_surroundings(scene), video)
        frame = next(iter(video.frames(2, 3)))
    light = {"sun": track.sun_at(2), "gain": track.gain_at(2)}
    alone = uw.render_frame(frame.image_linear, scene, frame.time_s, "reference", index=2, **light)
    from mr360uw.video import read_picture

    near = np.abs(codes(alone.image_linear) - codes(read_picture(tmp_path / "out_02.exr"))) <= FRAME_ALONE_CODES
    assert np.mean(near) >= FRAME_ALONE_FRACTION
