# SPDX-License-Identifier: Apache-2.0
"""The command line: what it makes, and what it says of bad input."""

from __future__ import annotations

import ctypes
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.progress import begin_phase, terminal_progress
from mr360uw.errors import EXTRAS
from mr360uw.ibl import track_suns
from mr360uw.ibl.sun.track import save_track
from mr360uw.sample import SampleDive
from mr360uw.video import write_exr
from mr360uw.video.spherical import SphericalMetadata, Stereo, write_spherical
from tests.first_look.plates import air
from tests.gate import FIRST_PASS, HANG_S, Gate
from tests.video.clips import packets, write_clip

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def scene(dive: SampleDive, tmp_path: Path) -> Path:
    """A scene file of its own, beside links to the dive's plate and mesh."""
    for file in (dive.plate, dive.mesh):
        (tmp_path / file.name).symlink_to(file)
    return Path(shutil.copy(dive.scene, tmp_path / "scene.toml"))


def test_new_writes_a_scene_that_runs(dive: SampleDive, tmp_path: Path, run: Run) -> None:
    code, out, err = run("new", dive.plate, dive.mesh, "--out", tmp_path / "my.toml")
    assert (code, err) == (0, "")
    assert str(tmp_path / "my.toml") in out
    text = (tmp_path / "my.toml").read_text()
    (sun,) = [line.split("; ", 1)[1] for line in out.splitlines() if line.startswith("light ")]
    assert "[water]" in text
    assert "# " in text
    arguments = ("composite", tmp_path / "my.toml", tmp_path / "out.mp4", "--frames", "0:2", "--backend", "reference")
    coarse = ("water.bands=8", "water.rough=true", "caustics.size=64", "caustics.grid=32", "draw.samples=5")
    coarse += ("draw.ambient_occlusion=false",)
    arguments += tuple(part for setting in coarse for part in ("--set", setting))
    code, out, err = run(*arguments)
    assert (code, err) == (0, "")
    assert "2 frames" in out
    assert f"light     first frame: {sun}\n" in out
    code, _, err = run(*arguments)
    assert code == 2
    assert "already there" in err
    code, _, err = run("new", dive.plate, dive.mesh, "--out", tmp_path / "my.toml")
    assert code == 2
    assert "--overwrite" in err


def test_explain_and_check_print_the_plan(scene: Path, run: Run) -> None:
    code, out, _ = run("composite", scene, "out.mp4", "--explain", "--backend", "reference")
    assert code == 0
    assert "whale.glb: " in out
    assert "caustics     runs" in out
    assert "not told by this plate" in "".join(line for line in out.splitlines() if line.startswith("look "))
    assert not (scene.parent / "out.mp4").exists()
    assert out.splitlines()[-1] == "nothing was written to out.mp4: --explain says what would run"
    code, out, _ = run("check", scene, "--set", 'water.type="none"', "--set", 'light.sun="detect"')
    assert code == 0
    assert "caustics     skipped  needs a sun and water" in out
    light = next(line for line in out.splitlines() if line.startswith("light "))  # a small sun, seen through waves
    assert "sun at azimuth" in light or "no sun; best candidate at azimuth" in light


def test_commands_tell_the_same_of_the_sun(scene: Path, run: Run) -> None:
    """Each by the same words; a composite also what its clip has, before its first frame."""
    dry = ("--set", 'light.sun="detect"', "--backend", "reference")
    cheap = ("--set", "draw.samples=1", "--set", "draw.ambient_occlusion=false", "--set", "caustics.enabled=false")
    lines = {}
    for command in (
        ("check", scene, *dry), ("composite", scene, "out.mp4", "--explain", *dry), ("analyse", scene),
        ("composite", scene, scene.parent / "out.mp4", "--frames", "0:1", *dry, *cheap),
    ):  # fmt: skip
        code, out, err = run(*command)
        assert (code, err) == (0, ""), command
        lines[command] = [line for line in out.splitlines() if line.startswith("light ")]
    check, explain, analysed, composed = lines.values()
    assert len(check) == 1
    assert check[0].startswith("light     first frame: ")
    assert check == explain
    assert analysed == composed
    assert composed[0] == check[0]
    assert re.fullmatch(r"light     clip: (perhaps a )?sun at azimuth \S+, elevation \S+ degrees.*", composed[1])
    report = out.index("wrote ")
    assert out.index("light     clip: ") < report


def test_an_analysis_of_a_plate_in_air_knows_no_water(tmp_path: Path, run: Run) -> None:
    write_exr(tmp_path / "air.exr", air())
    (tmp_path / "bare.toml").write_text('plate = "air.exr"\n')
    for source, words in (("air.exr", "where     in air: red is "), ("bare.toml", "note      the plate is in air")):
        code, out, _ = run("analyse", tmp_path / source)
        assert code == 0
        assert words in out
        page = (tmp_path / source).with_suffix(".html").read_text("utf-8")
        assert "Water, for a camera" not in page
        assert "Snell" not in out + page


def test_explain_measures_the_stages_of_a_frame(scene: Path, run: Run) -> None:
    dry = ("--set", 'water.type="none"', "--set", "plate.scale=0.25", "--backend", "reference")
    code, out, _ = run("composite", scene, "out.mp4", "--explain", "--measure", *dry)
    assert code == 0
    head, *rows = out[out.index("costs ") :].splitlines()
    took_ms = float(re.search(r"first frame, \d+x\d+: (\d+\.\d) ms of processor time", head)[1])
    spent = {row.split()[0]: float(row.split()[1]) for row in rows if " ms " in row}
    assert 0.0 < spent["draw_layer"] <= sum(spent.values()) <= 1.01 * took_ms
    assert "turned" in next(row for row in rows if row.split()[0] == "draw_layer")  # the light, which it follows
    assert not (scene.parent / "out.mp4").exists()
    code, _, err = run("composite", scene, "out.mp4", "--measure")
    assert code == 2
    assert "--measure - times the stages that --explain lists (got it alone) - give both" in err


def test_programs_read_what_is_found_as_json(scene: Path, tmp_path: Path, run: Run) -> None:
    code, said, _ = run("check", scene, "--json")
    found = json.loads(said)
    assert (code, found["problems"]) == (0, [])
    assert any(line.startswith("plate") for line in found["said"])
    code, said, errors = run("check", scene, "--json", "--set", "object.0.mesh=none.glb")
    assert code == 2
    assert json.loads(said)["problems"] == [line.strip() for line in errors.splitlines()[1:]]
    found = json.loads(run("info", "--json")[1])
    assert (found["version"], found["wrong"], "numpy" in found["packages"]) == (uw.__version__, False, True)
    plate = uw.load_scene(scene).plate.path
    found = json.loads(run("analyse", plate, "-o", tmp_path / "page.html", "--json")[1])
    assert found["medium"]["underwater"] is True
    assert str(tmp_path / "page.html") in found["written"]
    found = json.loads(run("match", scene, "--water", "0,0,20", "--json")[1])["found"]
    assert 0.0 <= found["confidence"] <= 1.0
    assert len(found["plate_code"]) == 3
    assert found["agreement"] is None  # of one frame it is not a number, which JSON has no word for


def test_the_schema_has_units_and_help(run: Run) -> None:
    code, out, _ = run("schema")
    schema = json.loads(out)
    depth = schema["$defs"]["CameraSettings"]["properties"]["depth_m"]
    assert code == 0
    assert depth["unit"] == "m"
    assert depth["maximum"] == 200.0
    assert "depth" in depth["description"]


def test_info_names_renderer_codecs_and_versions(run: Run) -> None:
    code, out, _ = run("info")
    assert code == 0
    assert "renderer" in out
    assert "libx264" in out
    assert f"numpy {np.__version__}" in out
    given = tomllib.loads((Path(__file__).resolve().parents[1] / "pyproject.toml").read_text("utf-8"))
    for extra, packages in EXTRAS.items():
        wanted = given["project"]["optional-dependencies"][extra]
        assert {re.split("[<>=]", one)[0] for one in wanted} == set(packages)
        assert f"extra     {extra}: " in out


# --- bad input: exit code 2, where - what (got ...) - what to do, and nothing written ------------------------------


def broken_mesh(name: str, folder: Path) -> Path:
    import trimesh

    path = folder / name
    if name == "empty.obj":
        path.write_text("v 0 0 0\n")
    elif name == "nan.ply":
        vertices = np.array([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]])
        trimesh.Trimesh(vertices, [[0, 1, 2]], process=False, validate=False).export(path)
    elif name == "point.ply":
        trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False, validate=False).export(path)
    elif name == "textured.obj":
        path.write_text(
            "mtllib textured.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
        )
        (folder / "textured.mtl").write_text("newmtl m\nmap_Kd nowhere.png\n")
    return path


@pytest.mark.parametrize(
    ("mesh", "says"),
    [
        ("empty.obj", "no triangles"),
        ("nan.ply", "not finite"),
        ("point.ply", "no extent"),
        ("textured.obj", "nowhere.png"),
    ],
)
def test_meshes_that_cannot_be_used(mesh: str, says: str, scene: Path, run: Run) -> None:
    path = broken_mesh(mesh, scene.parent)
    out = scene.parent / "out.mp4"
    code, _, err = run("composite", scene, out, "--set", f'object.0.mesh="{path}"', "--backend", "reference")
    assert code == 2
    assert Path(mesh).stem in err
    assert says in err
    assert not out.exists()


def broken_plate(name: str, folder: Path, dive: SampleDive) -> Path:
    path = folder / name
    if name == "zero.mp4":
        path.touch()
    elif name == "text.mp4":
        path.write_text("This is not a video.\n" * 50)
    elif name == "cut.mp4":
        data = dive.plate.read_bytes()
        path.write_bytes(data[: len(data) // 2])
    elif name in ("square.png", "wide.png"):
        import cv2

        cv2.imwrite(str(path), np.zeros((64, 64 if name == "square.png" else 200, 3), np.uint8))
    return path


@pytest.mark.parametrize(
    ("plate", "says"),
    [
        ("missing.mp4", "no such file"),
        ("zero.mp4", "empty"),
        ("text.mp4", "text.mp4"),
        ("cut.mp4", "cut"),
        ("square.png", "stereo"),
        ("wide.png", "2:1"),
    ],
)
def test_plates_that_cannot_be_used(plate: str, says: str, dive: SampleDive, scene: Path, run: Run) -> None:
    path = broken_plate(plate, scene.parent, dive)
    before = {p.name for p in scene.parent.iterdir()}
    code, _, err = run("composite", scene, scene.parent / "out.mp4", "--set", f'plate.path="{path}"')
    assert code == 2
    assert says in err.lower()
    assert " - " in err
    assert {p.name for p in scene.parent.iterdir()} == before


def test_every_problem_of_a_scene_at_once(scene: Path, run: Run) -> None:
    scene.write_text(
        scene.read_text().replace("depth_m = 4.0", "dept_m = 4.0").replace('type = "IB"', 'type = "2"')
        .replace('mesh = "whale.glb"', 'mesh = "no.glb"') + "\n[sae]\nwind_speed = 1.0\n"
    )  # fmt: skip
    code, _, err = run("check", scene)
    assert code == 2
    assert "3 problems" in err
    for part in ("did you mean 'depth_m'?", "(got '2')", "did you mean 'sea'?"):
        assert part in err
    scene.write_text(scene.read_text().replace("dept_m", "depth_m").replace('"2"', '"IB"').split("[sae]")[0])
    code, _, err = run("check", scene)
    assert code == 2
    assert "no such file" in err
    assert "no.glb" in err


def test_check_tells_every_problem_that_would_stop_a_run(scene: Path, run: Run) -> None:
    import cv2

    folder = scene.parent
    for number in range(3):  # for eight frames of the plate
        cv2.imwrite(str(folder / f"matte_{number:04d}.png"), np.zeros((128, 256), np.uint8))
    cv2.imwrite(str(folder / "square.png"), np.zeros((64, 64), np.uint8))
    save_track(track_suns([None, None]), folder / "sun.json")
    holdouts = '[{path="matte_%04d.png"}, {path="square.png"}]'
    settings = [f"holdout={holdouts}", 'light.track="sun.json"', 'output.codec="prores"', 'object.0.animation="fin"']
    overrides = [part for setting in settings for part in ("--set", setting)]
    before = {p.name for p in folder.iterdir()}
    code, _, err = run("check", scene, folder / "out.mp4", *overrides)
    assert code == 2
    assert "5 problems" in err
    for part in (
        "no animation of that name or number (got 'fin'",
        "matte_%04d.png - ends before the plate (got 3", "square.png - has not",
        "sun.json light.track - belongs to another clip (got 2 frames for 8)", ".mp4 cannot hold prores",
    ):  # fmt: skip
        assert part in err
    code, _, err = run("check", scene, folder / "out.mov", "--set", f"holdout={holdouts}", "--frames", "0:3")
    assert "1 problem\n" in err  # the square one
    code, out, _ = run("check", scene, "--set", 'output.codec="prores"')
    assert code == 0
    assert "output    .mov or .mkv can hold prores" in out
    code, out, _ = run("check", scene, folder / "out.mp4")
    assert code == 0
    assert {p.name for p in folder.iterdir()} == before


def test_check_reports_the_plate_s_problem_beside_others(scene: Path, run: Run) -> None:
    (scene.parent / "text.mp4").write_text("This is not a video.\n" * 50)
    code, _, err = run("check", scene, "--set", 'plate.path="text.mp4"', "--set", 'object.0.animation="fin"')
    assert code == 2
    assert "2 problems" in err


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("object.0.position_m=[0, 9, -3]", "is wholly above the water's surface"),
        ("object.0.position_m=[0, 0, 0]", "the camera is within its bounds (got time 0.00 s)"),
        (
            "object.0.key=[{time_s=0},{time_s=2, position_m=[0, 0, 0]}]",
            "the camera is within its bounds (got time 2.00 s)",
        ),
        ("object.0.scale=0.001", "is smaller than a pixel"),
    ],
)
def test_odd_places_are_noted_in_the_report(override: str, says: str, scene: Path, run: Run) -> None:
    code, out, _ = run("check", scene, "--set", override)
    assert code == 0
    assert [line for line in out.splitlines() if says in line and "object[0] whale.glb - " in line and " - " in line]
    arguments = ("--set", override, "--frames", "0", "--set", "light.sun=none", "--backend", "reference")
    code, out, _ = run("composite", scene, scene.parent / "out.png", *arguments)
    assert code == 0
    assert f"note: object[0] whale.glb - {says}" in out


def test_places_as_they_should_be_are_not_noted(scene: Path, run: Run) -> None:
    assert "object[0]" not in run("check", scene)[1]
    dry = run("check", scene, "--set", "object.0.position_m=[0,9,-3]", "--set", "water.type=none")[1]
    assert "above the water's surface" not in dry


def test_keys_of_a_motion_that_are_wrong_have_their_line(scene: Path, run: Run) -> None:
    scene.write_text(
        'plate = "dive.mp4"\n[[object]]\nmesh = "whale.glb"\n'
        "[[object.key]]\ntime_s = 1.0\n[[object.key]]\ntime_s = 0.5\n"
    )
    code, _, err = run("check", scene)
    assert code == 2
    assert f"{scene}:4 object[0].key - key 1 must be later than key 0 (got time_s 1, then 0.5) - sort" in err
    scene.write_text(scene.read_text() + "scale = -1.0\n")
    code, _, err = run("check", scene)
    assert code == 2
    assert f"{scene}:8 object[0].key[1].scale - must be in [1e-06, 1e+06]" in err


@pytest.mark.parametrize(
    ("stereo", "size"),
    [("top-bottom", "256x64"), ("left-right", "128x128")],
)
def test_squeezed_eyes_are_taken_as_they_are(stereo: Stereo, size: str, scene: Path, run: Run) -> None:
    plate = write_clip(scene.parent / "stereo.mp4", 2, size=(256, 128))
    write_spherical(plate, SphericalMetadata(stereo=stereo))
    overrides = ("--set", f'plate.path="{plate}"', "--set", 'surface.objects="none"')
    code, _, err = run("check", scene, *overrides)
    assert code == 2
    assert 'plate.eye = "left"' in err
    for eye in ("left", "both"):
        code, out, _ = run("check", scene, *overrides, "--set", f'plate.eye="{eye}"')
        assert code == 0
        assert f"{plate.name}: {size}" in out


@pytest.mark.parametrize(
    ("override", "says"),
    [
        ("camera.depth_m=-1", "must be > 0"),
        ("camera.depth_m=deep", "(got 'deep')"),
        ("camera.depht_m=1", "did you mean 'depth_m'?"),
        ("sea.tiling=blend", "unknown key"),
        ("object.3.scale=1", "no such entry"),
        ("nonsense", "key=value"),
        ("water.type=3", "(got 3)"),
    ],
)
def test_overrides_are_checked_like_the_file(override: str, says: str, scene: Path, run: Run) -> None:
    code, _, err = run("check", scene, "--set", override)
    assert code == 2
    assert says in err


@pytest.mark.parametrize(
    ("frames", "says"), [("5", "8"), ("9:12", "9"), ("3:3", "empty"), ("b:c", "range"), ("0:99", "99")]
)
def test_frames_outside_the_clip(frames: str, says: str, scene: Path, run: Run) -> None:
    code, _, err = run("composite", scene, scene.parent / "out.mp4", "--frames", frames, "--set", "object=[]")
    if frames == "5":  # a single frame is a range of one
        assert code == 0
        return
    assert code == 2
    assert says in err
    assert not (scene.parent / "out.mp4").exists()


def test_outputs_that_cannot_be_written(scene: Path, run: Run) -> None:
    code, _, err = run("composite", scene, scene.parent / "nowhere" / "out.mp4")
    assert code == 2
    assert "folder" in err
    code, _, err = run("composite", scene, scene.parent / "dive.mp4", "--overwrite")
    assert code == 2
    assert "which this run reads" in err
    code, _, err = run("composite", scene, scene.parent / "out.xyz")
    assert code == 2
    assert "out.xyz" in err


def test_sound_that_the_output_cannot_hold_is_told_before_the_first_frame(scene: Path, run: Run) -> None:
    # Matroska keeps no layout of the channels of PCM; MP4 needs one, and FFmpeg finds out when it completes the file
    plate = write_clip(scene.parent / "pcm.mkv", 4, size=(256, 128), audio_s=0.2, audio_codec="pcm_s16le")
    arguments = ("--set", f'plate.path="{plate}"', "--set", "object=[]")
    out = scene.parent / "out.mp4"
    code, _, err = run("composite", scene, out, *arguments)
    assert code == 2
    for part in (".mp4 cannot hold the sound of pcm.mkv (got pcm_s16le", "write .mov or .mkv", "output.sound = false"):
        assert part in err
    assert not list(scene.parent.glob("out*"))
    assert run("composite", scene, out.with_suffix(".mov"), *arguments)[0] == 0
    assert packets(out.with_suffix(".mov"), "audio")[0][2] == packets(plate, "audio")[0][2]
    assert run("composite", scene, out, *arguments, "--set", "output.sound=false")[0] == 0
    with av.open(str(out)) as container:
        assert not container.streams.audio


@pytest.mark.skipif(os.name != "posix", reason="needs a limit on the size of files")
def test_a_full_disk_is_told_and_the_run_goes_on_when_there_is_space(scene: Path, run: Run) -> None:
    import resource

    def composite(out: Path) -> list[str | Path]:
        # what the first pass finds has to fit below the limit; how frames are drawn does not matter
        settings = ["output.quality=lossless", "water.mode=table", "draw.samples=1", "draw.ambient_occlusion=false"]
        settings += ["caustics.enabled=false", "object.0.casts_shadow=false"]
        return ["composite", scene, out, "--backend", "reference", *(w for one in settings for w in ("--set", one))]

    # what is kept for later runs, above all compiled code, is stored on the first one
    assert run(*composite(scene.parent / "first.mkv"))[0] == 0
    out, before = scene.parent / "out.mkv", resource.getrlimit(resource.RLIMIT_FSIZE)
    # the disk is full while frames are encoded; of two frames, only when the encoder is asked for what it holds back
    for frames in ([], ["--frames", "0:2"]):
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))  # Python ignores its signal
        try:
            code, _, err = run(*composite(out), *frames)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert code == 2, err
        assert "out.mkv" in err
        assert [p.name for p in scene.parent.iterdir() if "out" in p.name] == ["out.mkv.mr360uw"]
    assert run(*composite(out))[0] == 0
    assert sorted(p.name for p in scene.parent.iterdir() if "out" in p.name) == ["out.mkv", "out.mkv.json"]


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["INT", "TERM"])
def test_a_run_interrupted_before_anything_is_finished_leaves_nothing(scene: Path, number: signal.Signals) -> None:
    def heeding() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # a shell has its jobs in the background ignore it

    out, gate = scene.parent / "out.mp4", Gate(scene.parent / "gate", FIRST_PASS)
    running = subprocess.Popen(
        [sys.executable, "-m", "mr360uw", "composite", scene, out, "--backend", "reference"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": gate.path},
        preexec_fn=heeding,  # noqa: PLW1509 - no other thread is at work here
    )
    gate.wait()
    assert (scene.parent / "out.mp4.mr360uw" / "run.json").is_file()
    running.send_signal(number)
    _, err = running.communicate(timeout=HANG_S)
    assert running.returncode == 128 + number
    assert ("interrupted" in err) == (number == signal.SIGINT)
    assert [p.name for p in scene.parent.iterdir() if "out" in p.name] == []


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interrupt_within_a_callback_stops_the_run_at_the_next_frame() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    interrupt = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))
    with terminal_progress() as progress:
        progress(1, 9)
        interrupt()  # C code has no place for the exception: it is dropped
        with pytest.raises(KeyboardInterrupt):
            progress(2, 9)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_each_phase_of_a_run_has_its_name() -> None:
    names: list[str] = []

    class Told:
        def __call__(self, done: int, total: int | None) -> None:
            pass

        def phase(self, name: str) -> None:
            names.append(name)

    begin_phase(Told(), "rendering")
    begin_phase(None, "rendering")
    with terminal_progress() as progress:
        begin_phase(progress, "rendering")
        progress(1, 9)
    assert names == ["rendering"]


def test_a_terminal_shows_the_phase_that_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    screen.isatty = lambda: True  # type: ignore[method-assign]
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    with terminal_progress() as progress:
        for name in ("reading the light", "rendering"):
            begin_phase(progress, name)
            progress(3, 9)
            end = time.monotonic() + HANG_S
            while name not in screen.getvalue():  # the bar is drawn by a thread of its own
                assert time.monotonic() < end
                time.sleep(0.01)
    text = screen.getvalue()
    assert text.index("reading the light") < text.index("rendering")
    assert "3/9" in text


def test_help_names_every_command() -> None:
    done = subprocess.run([sys.executable, "-m", "mr360uw", "--help"], capture_output=True, text=True, check=True)
    for command in ("composite", "clean", "new", "check", "sample", "analyse", "caustics", "schema", "info"):
        assert command in done.stdout
