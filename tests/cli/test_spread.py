"""Stretches of a take over a real cluster against the same take solved here."""

from __future__ import annotations

import gc
import threading
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("distributed")

from solver_backend.cli import spread
from solver_backend.cli.main import main
from solver_backend.cli.spread import ClusterStretches
from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.fitters.keyframes.optimise import Schedule, in_turn, solve_long
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import pose
from tests.support.finer_keys import resampled
from tests.support.stick_scene import FRAMES, StickScene
from tests.support.tended_cluster import Tended

pytestmark = pytest.mark.slow
SCHEDULE = Schedule((3.0,), 12, tolerance=1e-7)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tended]:
    cluster = Tended(2, tmp_path_factory.mktemp("cluster"))
    cluster.wait_for_workers(2)
    yield cluster
    cluster.close()
    with warnings.catch_warnings():  # Dask leaves sockets of workers that have died to the collector
        warnings.simplefilter("ignore")
        gc.collect()


def finer_scene() -> StickScene:
    scene = StickScene()
    finer = KeyframeLayout.even(FRAMES, 4)
    scene.start, scene.layout = resampled(scene.start, scene.layout, finer), finer
    return scene


@pytest.fixture
def scene() -> StickScene:
    return finer_scene()


def points_of(scene: StickScene, each: object) -> np.ndarray:
    found = solve_long(scene.model(), scene.layout, scene.start, SCHEDULE, windows=3, overlap=2, each=each)
    return pose(scene.subject, scene.poses(found.keys)).points


@pytest.fixture(scope="module")
def here() -> np.ndarray:
    """Return the points as this process finds them alone."""
    return points_of(finer_scene(), in_turn)


@pytest.mark.parametrize("kill", [False, True])
def test_stretches_over_a_cluster_are_those_of_one_machine(
    cluster: Tended, scene: StickScene, here: np.ndarray, kill: bool
) -> None:
    stretches = ClusterStretches(cluster.address)
    if kill:
        threading.Timer(0.2, cluster.kill, [1]).start()
    try:
        there = points_of(scene, stretches)
    finally:
        stretches.close()
    assert np.abs(there - here).max() < 1e-4, "0.1 mm"
    assert stretches.solved_there >= (1 if kill else 5)


def test_a_worker_of_another_version_solves_nothing(
    cluster: Tended, scene: StickScene, here: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster.wait_for_workers(2)
    monkeypatch.setattr(spread, "VERSION", "7.8.9")
    stretches = ClusterStretches(cluster.address)
    start = time.monotonic()
    try:
        there = points_of(scene, stretches)
    finally:
        stretches.close()
    assert stretches.solved_there == 0 and time.monotonic() - start < 60
    assert np.array_equal(there, here)


def test_no_scheduler_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spread, "_CONNECT_S", 0.5)
    with pytest.raises(CommandLineInvalid, match="No scheduler responds"):
        ClusterStretches("tcp://127.0.0.1:9")


def test_a_take_is_solved_by_command(cluster: Tended, tmp_path: Path) -> None:
    capture, motion = tmp_path / "capture.npz", tmp_path / "motion.npz"
    assert main(["dataset demo", "--out", str(capture)]) == 0
    assert main(["solve", str(capture), "--out", str(motion), "--method", "frame", "--scheduler", cluster.address]) == 0
    assert motion.is_file()
