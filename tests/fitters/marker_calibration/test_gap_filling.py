"""Gaps filled by the body: joined to both ends, and as long as what markers are off lasts."""

from __future__ import annotations

import numpy as np
import pytest

from research.baselines.rigid_filling import fill_rigidly
from solver_backend.fitters.measurements import gap_filling
from solver_backend.fitters.measurements.gap_filling import filled, lasting_frames
from solver_backend.geometry.rotations import exp_so3

FRAMES, FPS = 400, 60.0


def process(tau: float, count: int = 4, seed: int = 1) -> np.ndarray:
    """Return (F, M, 3) Ornstein-Uhlenbeck noise of 5 mm that lasts tau frames."""
    rng, share = np.random.default_rng(seed), np.exp(-1 / tau)
    values = np.zeros((FRAMES, count, 3))
    values[0] = rng.normal(size=(count, 3))
    for f in range(1, FRAMES):
        values[f] = share * values[f - 1] + np.sqrt(1 - share**2) * rng.normal(size=(count, 3))
    return 0.005 * values


@pytest.mark.parametrize("tau", [8.0, 40.0])
def test_how_long_errors_last_is_read_from_the_take(tau):
    assert lasting_frames(process(tau, count=60), 12) == pytest.approx(tau, rel=0.25)


@pytest.mark.parametrize("tau", [5.0, 60.0])
def test_gaps_are_joined_and_no_worse_than_a_line(tau):
    rng, off = np.random.default_rng(7), process(tau, count=30)
    turn = exp_so3(np.cumsum(0.02 * rng.normal(size=(FRAMES, 1, 3)), axis=0)) * np.ones((1, 30, 1, 1))
    solved = np.cumsum(0.01 * rng.normal(size=(FRAMES, 1, 3)), axis=0) + rng.normal(size=(30, 3))
    truth = solved + (turn @ off[..., None])[..., 0]
    measured, gap = truth.copy(), slice(100, 130)
    measured[gap] = np.nan
    found = filled(measured, solved, turn, FPS)
    np.testing.assert_array_equal(found[:100], truth[:100])
    ours, body = (np.linalg.norm(points - truth, axis=-1)[gap] for points in (found, solved))
    way = np.linspace(0, 1, 32)[1:-1, None, None]
    line = off[99] * (1 - way) + off[130] * way
    straight = np.linalg.norm(line - off[gap], axis=-1)
    # What lasts five frames is gone in the middle of the gap, where the body alone is best and a line is worst.
    assert ours.mean() < 1.1 * body.mean() and ours.mean() < 1.02 * straight.mean()
    assert ours[[0, -1]].mean() < 0.8 * body[[0, -1]].mean()


def test_a_gap_at_the_end_has_one_side():
    measured = np.full((20, 1, 3), 0.02)
    measured[15:] = np.nan
    found = filled(measured, np.zeros((20, 1, 3)), np.broadcast_to(np.eye(3), (20, 1, 3, 3)), FPS)
    assert np.isfinite(found).all() and found[15, 0, 0] == pytest.approx(0.02, rel=0.1)
    assert (np.diff(found[14:, 0, 0]) < 0).all()


def test_a_gap_of_minutes_is_the_body_in_its_middle():
    count = 20_000
    measured = 0.005 * np.random.default_rng(5).normal(size=(count, 1, 3))
    measured[500:-500] = np.nan
    found = filled(measured, np.zeros_like(measured), np.broadcast_to(np.eye(3), (count, 1, 3, 3)), FPS)
    assert np.isfinite(found).all() and np.abs(found[5000:-5000]).max() < 1e-12
    assert np.linalg.norm(found[500] - found[499]) < 0.5 * np.linalg.norm(found[499])


def test_the_trades_filling_is_exact_for_a_rigid_cluster():
    rng = np.random.default_rng(3)
    shape = 0.2 * rng.normal(size=(6, 3))
    turn = exp_so3(np.cumsum(0.05 * rng.normal(size=(80, 3)), axis=0))
    truth = (turn[:, None] @ shape[..., None])[..., 0] + np.cumsum(0.01 * rng.normal(size=(80, 1, 3)), axis=0)
    measured = truth.copy()
    measured[30:50, 2], measured[70:, 4] = np.nan, np.nan
    np.testing.assert_allclose(fill_rigidly(measured), truth, atol=1e-9)
    measured[30:50] = np.nan
    assert np.isfinite(fill_rigidly(measured)).all()


def soft_cluster(frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (F, 8, 3) markers on skin that slides alike under them, and where a body of rigid bones has them."""
    rng = np.random.default_rng(9)
    slide = np.sin(np.arange(frames)[:, None] / 25.0 + rng.uniform(0, 6, 3))
    ways = 0.012 * rng.normal(size=(8, 3, 3))
    turn = exp_so3(np.cumsum(0.02 * rng.normal(size=(frames, 1, 3)), axis=0))
    places = 0.1 * rng.normal(size=(8, 3)) + np.einsum("fs,msi->fmi", slide, ways)
    moved = np.cumsum(0.005 * rng.normal(size=(frames, 1, 3)), axis=0)
    rigid = (turn @ places.mean(axis=0)[..., None])[..., 0] + moved
    return (turn @ places[..., None])[..., 0] + moved + 0.0003 * rng.normal(size=(frames, 8, 3)), rigid


@pytest.mark.parametrize("gap", [slice(180, 220), slice(370, 400)], ids=["inside", "at the end"])
def test_neighbours_tell_where_a_hidden_marker_is(gap):
    truth, rigid = soft_cluster(400)
    measured = truth.copy()
    measured[gap, 2] = np.nan
    bones = np.broadcast_to(np.eye(3), (400, 8, 3, 3))
    found = filled(measured, rigid, bones, FPS)
    others = filled(measured[:, [2]], rigid[:, [2]], bones[:, [2]], FPS)
    off, alone = (np.linalg.norm(points - truth[gap, 2], axis=-1).mean() for points in (found[gap, 2], others[gap, 0]))
    assert off < 0.3 * alone
    rigidly = np.linalg.norm(fill_rigidly(measured)[gap, 2] - truth[gap, 2], axis=-1).mean()
    assert off < 0.3 * rigidly


def test_neighbours_that_tell_nothing_leave_the_body():
    rng, frames = np.random.default_rng(3), 400
    truth = rng.normal(size=(8, 3)) + np.cumsum(0.03 * rng.normal(size=(frames, 8, 3)), axis=0)
    solved = truth + 0.001 * rng.normal(size=truth.shape)
    measured = truth.copy()
    measured[180:220, 2] = np.nan
    found = filled(measured, solved, np.broadcast_to(np.eye(3), (frames, 8, 3, 3)), FPS)
    assert np.linalg.norm(found - truth, axis=-1)[180:220, 2].mean() < 0.003


def test_a_long_take_teaches_no_more_rows_than_a_short_one(monkeypatch):
    """A gap of ten frames in two minutes is learned from the frames around it."""
    truth, rigid = soft_cluster(7200)
    measured, learned = truth.copy(), []
    measured[3000:3010, 2] = np.nan
    among = gap_filling.among
    monkeypatch.setattr(gap_filling, "among", lambda *args: learned.append(len(args[2])) or among(*args))
    found = filled(measured, rigid, np.broadcast_to(np.eye(3), (7200, 8, 3, 3)), FPS)
    assert learned and max(learned) <= gap_filling.ROWS + 20
    assert np.linalg.norm(found - truth, axis=-1)[3000:3010, 2].mean() < 0.001


def test_points_that_the_body_does_not_wear_tell_where_the_only_marker_of_a_limb_is():
    """The solved limb follows its marker, and is 40 cm off where that is hidden. Some points are missing elsewhere."""
    truth, rigid = soft_cluster(400)
    gap, worn, others = slice(180, 220), truth[:, [2]].copy(), np.delete(truth, 2, axis=1)
    worn[gap], others[20:60, 1], others[300:, 3] = np.nan, np.nan, np.nan
    solved = rigid[:, [2]] + 0.4 * np.isnan(worn)
    bones = np.broadcast_to(np.eye(3), (400, 1, 3, 3))
    off, alone = (
        np.linalg.norm(filled(worn, solved, bones, FPS, more) - truth[:, [2]], axis=-1)[gap].mean()
        for more in (others, None)
    )
    assert off < 0.01 and alone > 0.1
    rare = np.where(np.arange(400)[:, None, None] < 230, others, np.nan)
    rare[:100] = np.nan
    np.testing.assert_array_equal(filled(worn, solved, bones, FPS, rare), filled(worn, solved, bones, FPS))


def raised_arm(arm: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (F, 30, 3) markers of a still person with an arm at (F,) angles, rad, and where a correct body has them.

    The last four are on the arm: two at the elbow, two at the wrist. Soft tissue moves all by some millimetres.
    """
    rng, frames = np.random.default_rng(seed), np.arange(len(arm))[:, None, None]
    trunk = rng.uniform([-0.2, -0.1, 0.9], [0.2, 0.1, 1.6], (10, 3))
    legs = rng.uniform([-0.2, -0.1, 0.0], [0.2, 0.1, 0.9], (16, 3))
    limb = np.array([[0, 0.03, -0.28], [0, -0.03, -0.28], [0, 0.03, -0.53], [0.03, -0.03, -0.54]])
    turn = exp_so3(arm[:, None] * np.array([0, -1.0, 0]))
    raised = np.array([0.22, 0, 1.4]) + np.einsum("fab,mb->fma", turn, limb)
    still = np.broadcast_to(np.concatenate([trunk, legs]), (len(arm), 26, 3))
    places = np.concatenate([still, raised], axis=1) + 0.003 * np.sin(frames / 40 + np.arange(3))
    slides, missed = (0.002 * np.sin(frames / t + rng.uniform(0, 6, (30, 3))) for t in (30, 47))
    truth = places + slides + 0.0004 * rng.normal(size=places.shape)
    return truth, places + missed + 0.004 * rng.normal(size=(30, 3))


def errors_of_the_wrist(
    arm: np.ndarray, hidden: np.ndarray, seed: int, blinks: int = 0, gone: tuple[int, ...] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of the filled wrist marker and of the body's, metres. The arm's others blink in the gap."""
    truth, solved = raised_arm(arm, seed)
    measured, rng = truth.copy(), np.random.default_rng(seed)
    for other in (26, 27, 29):
        measured[rng.choice(hidden, blinks, replace=False), other] = np.nan
    measured[np.ix_(hidden, list(gone))] = np.nan
    measured[hidden, 28] = np.nan
    found = filled(measured, solved, np.broadcast_to(np.eye(3), (len(arm), 30, 3, 3)), 100.0)
    ours, body = (np.linalg.norm(points - truth, axis=-1)[hidden, 28] for points in (found, solved))
    return ours, body


@pytest.mark.parametrize("blinks", [0, 3])
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    "hidden", [(790, 1010), (790, 1500), (0, 210)], ids=["a raise", "to the end", "from the start"]
)
def test_an_arm_that_moves_only_while_its_wrist_is_hidden_stays_at_the_body(hidden, seed, blinks):
    """The trunk, which did not move, tells nothing about a raised wrist: the elbow and the body do."""
    frames, (start, stop) = np.arange(1500), hidden
    arm = 1.5 * np.clip(np.minimum(frames - 800, 1000 - frames) / 50, 0, 1)
    if stop == 1500:
        arm = 1.5 * np.clip((frames - 800) / 50, 0, 1)
    if start == 0:
        arm = 1.5 * np.clip((200 - frames) / 50, 0, 1)
    ours, body = errors_of_the_wrist(arm, frames[start:stop], seed, blinks)
    assert ours.mean() < 2 * body.mean() and ours.max() < 2 * body.max()


@pytest.mark.parametrize("seed", range(5))
def test_neighbours_far_beyond_their_known_places_tell_nothing(seed):
    """Of the arm, only the elbow is seen in the only raise."""
    frames = np.arange(1500)
    arm = 1.5 * np.clip(np.minimum(frames - 800, 1000 - frames) / 50, 0, 1)
    ours, body = errors_of_the_wrist(arm, frames[790:1010], seed, gone=(29,))
    assert ours.mean() < 1.5 * body.mean() and ours.max() < 2 * body.max()


def test_exact_markers_that_never_moved_are_filled():
    """Neighbours that stand still have no known range at all."""
    truth = np.broadcast_to(np.random.default_rng(4).normal(size=(8, 3)), (200, 8, 3))
    measured = truth.copy()
    measured[80:120, 2] = np.nan
    bones = np.broadcast_to(np.eye(3), (200, 8, 3, 3))
    np.testing.assert_allclose(filled(measured, truth + 0.003, bones, FPS), truth, atol=1e-6)
    measured[80:120, 3:] += 0.1 * np.arange(1, 6)[:, None]
    assert np.linalg.norm(filled(measured, truth + 0.003, bones, FPS)[80:120, 2] - truth[0, 2], axis=-1).max() < 0.01


@pytest.mark.parametrize("shown", [1, 10, 19])
def test_a_marker_that_is_hardly_ever_seen_stays_at_the_body(shown):
    """Six neighbours have 18 coordinates, so 19 frames are predicted without any error."""
    frames = np.arange(1500)
    ours, body = errors_of_the_wrist(0.8 * np.sin(frames / 25), np.r_[0:700, 700 + shown : 1500], seed=0)
    assert ours.mean() < 1.2 * body.mean() and ours.max() < 1.5 * body.max()
