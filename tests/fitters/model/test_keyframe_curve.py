"""The curve through keyframes: its value, its Jacobian and its vector-Jacobian product, each part of the keys."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver_backend.body.state_layout import CODE, RESIDUAL, ROOT, TRANSL
from solver_backend.fitters.model.keyframe_curve import KeyframeCurve, key_poses
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import Keyframes, PosedFrames
from solver_backend.geometry.interpolation import sider2
from solver_backend.geometry.rotations import exp_so3, matrix_from_quat
from tests.support.layouts import LAYOUTS, ON_MANIFOLD, POSE, WHOLE
from tests.support.random_keys import random_keys
from tests.support.toy_prior import ToyPrior

FRAMES, WINDOW = 27, 9
LAYOUT = KeyframeLayout.even(FRAMES, WINDOW)
ROWS = LAYOUT.rows()
WINDOWS = np.arange(LAYOUT.num_windows)
PARTS = {"latent": WHOLE[CODE], "root": WHOLE[ROOT], "transl": WHOLE[TRANSL], "residual": WHOLE[RESIDUAL]}


def curve_through(keys: Keyframes, *, residuals: bool) -> KeyframeCurve:
    return KeyframeCurve.through(keys.of_windows(WINDOWS), ROWS.time, residuals=residuals)


def tangent_between(poses: PosedFrames, base: PosedFrames) -> np.ndarray:
    """Return (F, 69): the step that leads from one pose to the other."""
    tangent = np.empty((len(base.root), POSE.dof))
    for columns, R, R0 in (
        (POSE.root, poses.root, base.root), (POSE.joints, poses.local, base.local),
    ):  # fmt: skip
        turns = (R @ np.swapaxes(R0, -1, -2)).reshape(-1, 3, 3)
        tangent[:, columns] = Rotation.from_matrix(turns).as_rotvec().reshape(len(R), -1)
    tangent[:, POSE.transl] = poses.transl - base.transl
    return tangent


def along(keys: Keyframes, direction: np.ndarray, *, residuals: bool) -> np.ndarray:
    """Return (W n, 69): the central difference of the poses along a direction of the keys."""
    prior, step = ToyPrior(), 1e-5
    base = curve_through(keys, residuals=residuals).poses(prior)
    up, down = (
        tangent_between(curve_through(moved, residuals=residuals).poses(prior), base)
        for moved in (keys.retract(sign * step * direction, LAYOUTS[residuals]) for sign in (1, -1))
    )
    return (up - down) / (2 * step)


def directions(parts: str, count: int, residuals: bool):
    """Yield random directions of the keys, in one part of their tangents or in all."""
    rng = np.random.default_rng(4)
    for _ in range(count):
        direction = rng.normal(size=(LAYOUT.num_keys, LAYOUTS[residuals].dof))
        if parts != "all":
            alone = np.zeros_like(direction)
            alone[:, PARTS[parts]] = direction[:, PARTS[parts]]
            direction = alone
        yield direction


@pytest.mark.parametrize(("free", "screw"), [(1, False), (2, True), (3, False), (3, True)])
def test_other_curves_have_the_derivatives_of_central_differences(free: int, screw: bool):
    """SIDER-n of other n and the root on screws: the Jacobian, and the product with a cotangent."""
    layout, prior, step = KeyframeLayout.even(FRAMES, WINDOW, free=free), ToyPrior(), 1e-5
    first = random_keys(layout.num_keys).select(np.zeros(layout.num_keys, dtype=int))
    rng, rows = np.random.default_rng(4), layout.rows()
    keys = first.retract(0.1 * rng.normal(size=(layout.num_keys, ON_MANIFOLD.dof)), ON_MANIFOLD)

    def curve(some: Keyframes) -> KeyframeCurve:
        return KeyframeCurve.through(some.of_windows(WINDOWS, free), rows.time, residuals=False, screw=screw)

    base, vjp = curve(keys).poses_with_vjp(prior)
    jacobian, cotangent = curve(keys).jacobian(prior, ON_MANIFOLD), rng.normal(size=(rows.time.size, POSE.dof))
    by_keys = vjp(cotangent).by_tangents(keys, ON_MANIFOLD)
    for _ in range(3):
        direction = rng.normal(size=(layout.num_keys, ON_MANIFOLD.dof))
        ends = [curve(keys.retract(s * step * direction, ON_MANIFOLD)).poses(prior) for s in (1, -1)]
        numeric = (tangent_between(ends[0], base) - tangent_between(ends[1], base)) / (2 * step)
        of_window = np.stack([direction[free * w : free * w + free + 1].ravel() for w in WINDOWS])
        analytic = np.einsum("fij,fj->fi", jacobian, np.repeat(of_window, rows.time.shape[1], axis=0))
        np.testing.assert_allclose(analytic, numeric, atol=1e-5 * np.abs(numeric).max())
        np.testing.assert_allclose((by_keys * direction).sum(), (cotangent * numeric).sum(), rtol=1e-6)


CASES = [(part, True) for part in (*PARTS, "all")] + [(part, False) for part in ("latent", "root", "transl", "all")]


def test_frames_pass_through_their_keys():
    keys, prior = random_keys(LAYOUT.num_keys), ToyPrior()
    for k, when in enumerate((0.0, 0.5, 1.0)):
        curve = KeyframeCurve.through(keys.of_windows(WINDOWS), np.full((len(WINDOWS), 1), when), residuals=False)
        frames, chosen = curve.poses(prior), keys.select(2 * WINDOWS + k)
        np.testing.assert_allclose(frames.transl, chosen.transl, atol=1e-12)
        np.testing.assert_allclose(frames.local, prior.decode(chosen.z), atol=1e-9)


def test_value_is_sider2_on_codes_and_root_and_the_parabola_on_the_rest():
    """Equations 6.9 and 6.10, one frame at a time."""
    keys, prior = random_keys(LAYOUT.num_keys), ToyPrior()
    found = curve_through(keys, residuals=True).poses(prior)
    flat = np.c_[keys.transl, keys.residual.reshape(LAYOUT.num_keys, -1)]
    for row, (w, n) in enumerate(np.ndindex(*ROWS.time.shape)):
        t, own = ROWS.time[w, n], slice(2 * w, 2 * w + 3)
        z, quat = sider2(*keys.z[own], t), sider2(*keys.quat[own], t)
        through = np.polyfit([0, 0.5, 1], flat[own], 2)
        rest = np.array([t**2, t, 1]) @ through
        local = exp_so3(rest[3:].reshape(21, 3)) @ prior.decode(z[None])[0]
        np.testing.assert_allclose(found.local[row], local, atol=1e-9)
        np.testing.assert_allclose(found.root[row], matrix_from_quat(quat), atol=1e-9)
        np.testing.assert_allclose(found.transl[row], rest[:3], atol=1e-9)


@pytest.mark.parametrize(("part", "residuals"), CASES)
def test_jacobian_equals_central_differences(part, residuals):
    keys = random_keys(LAYOUT.num_keys)
    jacobian = curve_through(keys, residuals=residuals).jacobian(ToyPrior(), LAYOUTS[residuals])
    width = ROWS.time.shape[1]
    for direction in directions(part, 3, residuals):
        numeric = along(keys, direction, residuals=residuals)
        of_window = np.stack([direction[2 * WINDOWS + k] for k in range(3)], axis=1).reshape(len(WINDOWS), -1)
        analytic = np.einsum("fij,fj->fi", jacobian, np.repeat(of_window, width, axis=0))
        np.testing.assert_allclose(analytic, numeric, atol=1e-6 * np.abs(numeric).max())


@pytest.mark.parametrize(("part", "residuals"), CASES)
def test_vjp_equals_central_differences(part, residuals):
    keys = random_keys(LAYOUT.num_keys)
    _, vjp = curve_through(keys, residuals=residuals).poses_with_vjp(ToyPrior())
    cotangent = np.random.default_rng(7).normal(size=(ROWS.time.size, POSE.dof))
    by_keys = vjp(cotangent).by_tangents(keys, LAYOUTS[residuals])
    assert by_keys.shape == (LAYOUT.num_keys, LAYOUTS[residuals].dof)
    for direction in directions(part, 3, residuals):
        numeric = (cotangent * along(keys, direction, residuals=residuals)).sum()
        np.testing.assert_allclose((by_keys * direction).sum(), numeric, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("residuals", [False, True])
def test_vjp_is_the_transposed_jacobian_summed_over_windows(residuals):
    keys = random_keys(LAYOUT.num_keys)
    curve, dof = curve_through(keys, residuals=residuals), LAYOUTS[residuals].dof
    cotangent = np.random.default_rng(8).normal(size=(ROWS.time.size, POSE.dof))
    found = curve.poses_with_vjp(ToyPrior())[1](cotangent).by_tangents(keys, LAYOUTS[residuals])
    by_frames = np.einsum("fij,fi->fj", curve.jacobian(ToyPrior(), LAYOUTS[residuals]), cotangent)
    by_windows = by_frames.reshape(len(WINDOWS), -1, 3, dof).sum(axis=1)
    expected = np.zeros_like(found)
    for k in range(3):
        np.add.at(expected, 2 * WINDOWS + k, by_windows[:, k])
    # The Jacobian is in single precision.
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_terms_in_the_codes_themselves_reach_the_keys():
    keys = random_keys(LAYOUT.num_keys)
    curve = curve_through(keys, residuals=False)
    by_codes = np.random.default_rng(9).normal(size=(ROWS.time.size, 32))
    nothing = np.zeros((ROWS.time.size, POSE.dof))
    by_keys = curve.poses_with_vjp(ToyPrior())[1](nothing, by_codes).by_tangents(keys, ON_MANIFOLD)
    for direction in directions("latent", 3, residuals=False):
        moved = (keys.retract(sign * 1e-5 * direction, ON_MANIFOLD) for sign in (1, -1))
        values = [curve_through(part, residuals=False).codes.value for part in moved]
        numeric = (by_codes * (values[0] - values[1]).reshape(len(by_codes), -1)).sum() / 2e-5
        np.testing.assert_allclose((by_keys * direction).sum(), numeric, rtol=1e-6)


def test_poses_at_scattered_frames_are_those_of_the_rows():
    keys, prior = random_keys(LAYOUT.num_keys), ToyPrior()
    rows = curve_through(keys, residuals=True).poses(prior)
    frames = np.array([3, 4, 11, 26])
    found = key_poses(prior, keys, LAYOUT, frames, residuals=True)
    at = [int(np.flatnonzero((ROWS.frames.reshape(-1) == f) & (ROWS.weight.reshape(-1) > 0))[0]) for f in frames]
    for name in ("root", "local", "transl"):
        np.testing.assert_allclose(getattr(found, name), getattr(rows, name)[at], atol=1e-12)
