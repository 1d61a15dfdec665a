"""``solve --method noise-aware``: from a capture of markers to a motion, with gaps and with a single frame."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.marker_layouts import load_layouts
from solver_backend.body.markers import marker_landmarks
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.progress import silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters import solve
from solver_backend.fitters.pipeline import prepare
from solver_backend.geometry.rotations import exp_so3
from solver_backend.metrics import accel_error_m_s2, mpjpe_mm
from solver_backend.priors.gaussian_vae import load_vae
from solver_backend.types import FLAG_UNSEEN, Capture, MarkerCloud

LABELS = load_layouts().layouts["MANIFOLD_53"]
BETAS = np.array([0.6, -0.5, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def take(num_frames: int) -> tuple[Capture, np.ndarray]:
    """Return a slow movement with four markers far off in every frame, and the true joints."""
    rng, body = np.random.default_rng(2), load_body()
    ends = 0.5 * rng.normal(size=(2, 32))
    codes = np.linspace(ends[0], ends[1], num_frames)
    root = np.tile(exp_so3(np.array([np.pi / 2, 0.0, 0.0])), (num_frames, 1, 1))
    local, transl = load_vae("rvposer").decode(codes), np.full((num_frames, 3), [0.2, 0.1, 1.0])
    posed = pose_landmarks(body, marker_landmarks(body, LABELS), BETAS, root, local, transl)
    points = posed.points.copy()
    points[np.arange(num_frames)[:, None], rng.integers(0, 53, (num_frames, 4))] += [0.15, 0.2, -0.1]
    return Capture(name="take", markers=MarkerCloud(points, 60.0, tuple(LABELS))), posed.skeleton.joints[:, :24]


@pytest.mark.slow
def test_a_take_with_displaced_markers_and_an_unseen_frame_is_solved() -> None:
    capture, joints = take(5)
    assert capture.markers is not None
    capture.markers.positions[2] = np.nan
    motion = solve(capture, SolveSettings(method="noise-aware")).motion
    assert mpjpe_mm(motion.joints, joints) < 15.0
    assert motion.flags is not None and (motion.flags & FLAG_UNSEEN > 0).tolist() == [False, False, True, False, False]
    assert motion.provenance["prior"]["name"] == "rvposer"
    assert abs(motion.betas[0] - BETAS[0]) < 0.4, "size is found; least squares lets displaced markers bend the rest"
    before, unseen, after = motion.joints[1:4]
    off = np.linalg.norm(unseen - 0.5 * (before + after), axis=-1).max()
    assert off < 0.25 * np.linalg.norm(after - before, axis=-1).max(), "it is bridged between its neighbours"


@pytest.mark.slow
def test_the_temporal_term_removes_jitter() -> None:
    capture, joints = take(12)
    assert capture.markers is not None
    capture.markers.positions[:] += 0.005 * np.random.default_rng(3).normal(size=capture.markers.positions.shape)
    alone, together = (
        solve(capture, SolveSettings(method="noise-aware", temporal=temporal)).motion for temporal in (False, True)
    )
    jitter = [accel_error_m_s2(motion.joints, joints, 60.0) for motion in (alone, together)]
    assert jitter[1] < 0.5 * jitter[0]
    assert mpjpe_mm(together.joints, joints) < 15.0


def test_a_prior_without_gaussian_codes_is_refused_before_anything_is_measured() -> None:
    with pytest.raises(JobInvalid, match="Gaussian codes"):
        prepare(take(2)[0], SolveSettings(method="noise-aware", prior="sposer"), silent)


@pytest.mark.slow
def test_a_known_shape_stays_and_one_frame_is_enough() -> None:
    capture, joints = take(1)
    motion = solve(capture, SolveSettings(method="noise-aware", betas=tuple(BETAS))).motion
    np.testing.assert_array_equal(motion.betas, BETAS)
    assert mpjpe_mm(motion.joints, joints) < 15.0


@pytest.mark.slow
def test_torch_and_numpy_solve_alike() -> None:
    pytest.importorskip("torch")
    capture, _ = take(2)
    found = [
        solve(capture, SolveSettings(method="noise-aware", betas=tuple(BETAS), backend=backend)).motion.joints
        for backend in ("numpy", "torch")
    ]
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-9)
