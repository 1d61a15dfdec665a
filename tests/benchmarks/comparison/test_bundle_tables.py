"""Test the method comparison: truth scores perfectly, missing figures stay empty, and runs are stored by their code."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from research.baselines import BaselineResult
from solver_backend.geometry.small_matrices import packed
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.types import Capture, JointSet, Motion
from tests.benchmarks.bench_bundle import table
from tests.benchmarks.comparison.judgement import COLUMNS, by_sight, coverage, exchanges_undone, judged, worst_joints
from tests.benchmarks.comparison.methods import (
    BASELINES,
    EXACT_PRIOR,
    OURS,
    PUBLISHED,
    Method,
    ablations,
    compared,
    copied,
    curves,
)
from tests.benchmarks.comparison.requirements import requirements
from tests.benchmarks.comparison.runs import Outcome, Run
from tests.benchmarks.comparison.sections import SECTIONS, Scope, Section, medians
from tests.support.scenes import small_motion


@pytest.fixture(scope="module")
def capture() -> Capture:
    return demo_capture(num_frames=12)


def _motion(capture: Capture, joints: np.ndarray) -> Motion:
    truth = capture.truth
    return Motion(truth["betas"], truth["global_orient"], truth["body_pose"], truth["transl"], capture.fps, "b", joints)


def test_the_truth_scores_perfectly(capture: Capture) -> None:
    truth = capture.truth
    row = judged(capture, BaselineResult(truth["keypoints3d"], _motion(capture, truth["joints"])))
    zeros = ("mpjpe_mm", "pa_mpjpe_mm", "rmse_mm", "mae_deg", "accel_m_s2", "kp_mpjpe_mm", "kp_accel_m_s2")
    assert [row[c] for c in zeros] == pytest.approx([0.0] * len(zeros), abs=1e-6)
    assert (row["pck3"], row["pck7"]) == (100.0, 100.0)
    assert tuple(row) == COLUMNS


def test_points_without_a_body_leave_cells_empty(capture: Capture) -> None:
    row = judged(capture, BaselineResult(capture.truth["keypoints3d"]))
    assert np.isnan(row["mpjpe_mm"]) and np.isnan(row["mae_deg"]) and row["kp_mpjpe_mm"] == 0.0
    run = Run(Method("MuVS"), "a")
    section = Section("t", {"filter": [run]}, COLUMNS)
    lines = table(section, {run: Outcome(row, [], [], None)}).splitlines()
    assert lines[1].split()[:3] == ["filter", "-", "-"]


def test_the_worst_joint_is_named_with_its_frame(capture: Capture) -> None:
    joints = capture.truth["joints"].copy()
    joints[:, 4, 0] += 0.02
    joints[7, 4, 0] += 0.2
    name, error_mm, frame = worst_joints(capture, BaselineResult(joints, _motion(capture, joints)), 1)[0]
    assert (name, frame) == ("left_knee", 7)
    assert error_mm == pytest.approx(20.0 + 200.0 / 12, abs=0.1)


def test_an_exchange_leaves_a_trace_where_its_limb_is_wrong_while_it_lasts(capture: Capture) -> None:
    rng = np.random.default_rng(0)
    points = capture.truth["keypoints3d"] + 0.01 * rng.normal(size=capture.truth["keypoints3d"].shape)
    swaps = np.array([[0, 1, 2, 6], [1, 0, 8, 12], [2, 0, 1, 3]])
    exchanged = replace(capture, truth=capture.truth | {"swaps": swaps})
    assert exchanges_undone(exchanged, points) == 100.0
    knees = [JointSet.BODY_25.keypoints.index(f"{side}_knee") for side in ("left", "right")]
    points[2:6, knees] += 0.2
    assert exchanges_undone(exchanged, points) == 50.0
    assert np.isnan(exchanges_undone(capture, points))


def test_honest_ellipsoids_hold_what_they_promise() -> None:
    rng = np.random.default_rng(1)
    root = rng.normal(size=(400, 24, 3, 3)) * [0.005, 0.01, 0.03]
    joints = rng.normal(size=(400, 24, 3))
    found = joints + (root @ rng.normal(size=(400, 24, 3, 1)))[..., 0]
    held = coverage(found, joints, packed(root @ root.swapaxes(-1, -2)))
    assert [held["held50"], held["held80"], held["held95"]] == pytest.approx([50, 80, 95], abs=1.5)
    assert coverage(found, joints, None) == {}


def test_methods_have_names_of_their_own_and_known_settings() -> None:
    methods = [*compared(), *ablations(), *curves()]
    assert len({method.name for method in compared()}) == len(compared()) == len(BASELINES) + len(copied()) + 3
    assert all(method.known for method in methods)
    assert not Method.of(OURS, nonsense=1).known
    assert Method.of(PUBLISHED, window=30).name == "BundleMoCap++, window 30"
    assert len({method.name for method in ablations()}) == len(ablations())


def test_every_section_names_runs_and_columns() -> None:
    for name, make in SECTIONS.items():
        section = make(Scope(("13_29:600+600", "salsa_07:20+600"), frames=1000))
        assert section.runs and section.columns, name
        assert all(run.method.known for run in section.runs)
    assert medians([{"a": 1.0, "b": np.nan}, {"a": 3.0}, {"a": 2.0}])["a"] == 2.0


def test_requirements_are_judged_by_ratio() -> None:
    row = dict.fromkeys(COLUMNS, 10.0) | {"seconds": 1.0}
    tables = {"methods": {name: dict(row) for name in (*BASELINES, EXACT_PRIOR, "ours, global")}}
    tables["methods"][EXACT_PRIOR]["mpjpe_mm"] = 4.0
    tables["methods"]["ours, global"] |= {"mpjpe_mm": 4.9, "undone": 96.0}
    verdicts = {item.text: item for item in requirements(tables)}
    assert verdicts["MPJPE against MuVS"].met and verdicts["MPJPE against MuVS"].value == pytest.approx(0.49)
    assert not verdicts["acceleration error against MuVS"].met
    assert verdicts["MPJPE against the same with a prior without error"].value == pytest.approx(4.9 / 4.0)
    assert verdicts["exchanges of 3 frames or more without a trace, %"].met
    assert verdicts["MPJPE against MuVS"].line().startswith("  ✓")


def test_seen_and_bridged_frames_are_judged_apart() -> None:
    motion = small_motion(6)
    motion = replace(motion, flags=np.array([0, 0, 1, 3, 2, 0], np.uint8))
    joints = motion.joints.copy()
    joints[[2, 3], :, 0] += 0.2
    assert by_sight(motion, joints) == pytest.approx({"seen_mm": 0.0, "unseen_mm": 200.0}, abs=1e-3)
    assert set(by_sight(replace(motion, flags=np.zeros(6, np.uint8)), joints)) == {"seen_mm"}
