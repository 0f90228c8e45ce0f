# SPDX-License-Identifier: Apache-2.0
"""Several processes make the same frames as one."""

from __future__ import annotations

import multiprocessing
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import mr360uw as uw
from mr360uw.base.files import work_path
from mr360uw.runs import job as workers
from mr360uw.runs.job import Job
from mr360uw.sample import SampleDive
from mr360uw.scene import Scene
from mr360uw.scene.model import load_scene
from tests.gate import HANG_S

LOSSLESS = ["output.segment_s=0.08", "output.codec=ffv1"]
KEYS = """keys=[
    {parameter = "sea.wind_speed", time_s = [0, 0.2], value = [2, 7]},
    {parameter = "object.0.position_m.1", time_s = [0, 0.2], value = [-0.5, 0.3]},
    {parameter = "water.sun_share", time_s = [0, 0.2], value = [0.4, 0.43]},
]"""


@pytest.fixture
def scene(dive: SampleDive) -> Scene:
    return load_scene(dive.scene, [*LOSSLESS, KEYS])


def pictures(path: Path) -> list[np.ndarray]:
    with uw.open_video(path) as video:
        return [frame.pixels.y.copy() for frame in video.frames()]


@pytest.fixture(scope="module")
def alone(dive: SampleDive, tmp_path_factory: pytest.TempPathFactory) -> list[np.ndarray]:
    """The pictures of a run by one process, of a clip whose parameters change from frame to frame."""
    out = tmp_path_factory.mktemp("alone") / "out.mkv"
    uw.composite_video(load_scene(dive.scene, [*LOSSLESS, KEYS]), out, backend="reference")
    return pictures(out)


def test_a_frame_of_keyed_parameters_is_the_same_alone(scene: Scene, alone: list[np.ndarray], tmp_path: Path) -> None:
    out = tmp_path / "out.mkv"
    uw.composite_video(scene, out, frames=(5, 6), backend="reference")
    np.testing.assert_array_equal(pictures(out)[0], alone[5])


def test_two_workers_make_the_same_frames_as_one_process(scene: Scene, alone: list[np.ndarray], tmp_path: Path) -> None:
    out = tmp_path / "out.mkv"
    seen: list[int] = []
    report = uw.composite_video(scene, out, backend="reference", workers=2, progress=lambda done, _: seen.append(done))
    assert report.workers == 2
    assert seen[-8:] == list(range(1, 9))
    np.testing.assert_array_equal(pictures(out), alone)


def test_the_part_of_a_worker_that_dies_is_given_to_another(
    scene: Scene, alone: list[np.ndarray], tmp_path: Path
) -> None:
    out, killed = tmp_path / "out.mkv", []

    def kill_one(done: int, total: int | None) -> None:  # noqa: ARG001 - as progress is called
        workers = multiprocessing.active_children()
        if not killed and workers and (work_path(out) / "analysis.npz").exists():
            killed.append(workers[0].pid)
            workers[0].kill()

    uw.composite_video(scene, out, backend="reference", workers=2, progress=kill_one)
    assert killed
    np.testing.assert_array_equal(pictures(out), alone)


def test_a_part_that_kills_every_worker_is_given_up_after_two(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not after one, which may have been killed for its memory, and not after three."""
    started: list[int] = []

    class Dying(workers._Worker):
        def __init__(self, _job: Job, number: int, _count: int) -> None:
            self.connection, there = multiprocessing.Pipe()
            there.close()
            started.append(number)
            self.process, self.part = SimpleNamespace(join=bool, terminate=bool, exitcode=-9), None

        def take(self, part: tuple[int, int]) -> None:
            self.part = part

    monkeypatch.setattr(workers, "_Worker", Dying)
    job = Job(Scene(plate={"path": "a.mp4"}), Path("out.mp4"), Path("work"), "reference", None, ((3, 7),))
    with pytest.raises(uw.VideoError, match=r"frames 3:7 - 2 workers died over them"):
        workers.render_in_workers(1, job, lambda: None)
    assert len(started) == 2


def test_an_error_in_a_worker_is_that_of_the_run(dive: SampleDive, tmp_path: Path) -> None:
    with pytest.raises(uw.ParameterError, match="workers"):
        uw.composite_video(load_scene(dive.scene, LOSSLESS), tmp_path / "out.mkv", workers=0)
    assert list(tmp_path.iterdir()) == []


def test_a_cluster_makes_the_same_frames(scene: Scene, alone: list[np.ndarray], tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="needs mr360uw[farm]")
    out = tmp_path / "out.mkv"
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        report = uw.composite_video(scene, out, backend="reference", cluster=cluster.scheduler_address)
    assert report.workers == 2
    np.testing.assert_array_equal(pictures(out), alone)


def let_the_workers_die(address: str) -> None:
    """Have the workers of a cluster killed by the first part that they are given, as by too little memory."""

    def die_at_parts() -> None:
        import os
        import signal

        from mr360uw.runs import job as workers

        workers.render_part = lambda _job, _part: os.kill(os.getpid(), signal.SIGKILL)

    distributed = pytest.importorskip("distributed", reason="needs mr360uw[farm]")
    with distributed.Client(address) as client:
        client.wait_for_workers(1)
        client.run(die_at_parts)


@pytest.mark.parametrize("started_again", [True, False])
def test_a_cluster_whose_workers_die_ends_the_run(
    scene: Scene, started_again: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At once where the scheduler gives a part up; where no worker is left, after a time in which none came."""
    distributed = pytest.importorskip("distributed", reason="needs mr360uw[farm]")
    import dask

    monkeypatch.setattr(workers, "_LOOK_S", 0.1)
    monkeypatch.setattr(workers, "_NO_WORKER_S", HANG_S if started_again else 0.1)
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0 if started_again else 3}),
        distributed.LocalCluster(n_workers=int(started_again), threads_per_worker=1, dashboard_address=None) as cluster,
    ):
        address = cluster.scheduler_address
        command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--no-nanny", "--no-dashboard"]
        worker = None if started_again else subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL)
        let_the_workers_die(address)
        with pytest.raises(uw.VideoError, match="--dask - the scheduler or its workers died"):
            uw.composite_video(scene, tmp_path / "out.mkv", backend="reference", cluster=address)
        assert worker is None or worker.wait(HANG_S) == -signal.SIGKILL


def test_a_scheduler_that_does_not_answer_is_an_error(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed", reason="needs mr360uw[farm]")
    monkeypatch.setattr(workers, "_ANSWER_S", 0.5)
    with pytest.raises(uw.ParameterError, match="scheduler"):
        uw.composite_video(scene, tmp_path / "out.mkv", cluster="tcp://127.0.0.1:9")
    assert list(tmp_path.iterdir()) == []
