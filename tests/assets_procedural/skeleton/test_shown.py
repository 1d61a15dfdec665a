"""What Blender shows of the body beyond the solver's: the smoothing, its volume, and that the file can be rebuilt."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from assets_procedural.build import BODY_FILE
from assets_procedural.quality.contact_sheet import BakedBody, read_baked, rotations
from assets_procedural.shown import SHOWN_FILE, build_shown
from assets_procedural.skeleton.correctives import sample_poses
from assets_procedural.skeleton.shown import DeltaMush
from assets_procedural.skeleton.skinning import vertex_areas, volume
from tests.support.shown_body import NAMED, bodies, figures


@pytest.fixture(scope="module")
def body() -> BakedBody:
    return read_baked()


def test_smoothing_follows_a_turned_body_and_leaves_the_rest_pose(body: BakedBody) -> None:
    mush, turn = DeltaMush(body.vertices, body.faces, 0.03), Rotation.from_rotvec([0.4, -1.1, 0.7])
    np.testing.assert_allclose(mush(body.vertices), body.vertices, atol=1e-9)
    moved = turn.apply(body.vertices) + [0.3, -0.2, 0.9]
    np.testing.assert_allclose(mush(moved), moved, atol=1e-9)


@pytest.mark.parametrize(
    ("pose", "share"), [("arms down", 0.9), ("crossed arms", 0.9), ("seated", 0.4), ("cross-legged", 0.4)]
)
def test_the_shown_body_loses_less_volume(pose: str, share: float) -> None:
    lost = []
    for found in bodies().values():
        lost.append(
            abs(volume(found.posed(rotations(NAMED[pose])), found.faces) / volume(found.vertices, found.faces) - 1)
        )
    assert lost[1] < share * lost[0]


def test_the_shown_body_keeps_volume_and_surface_better_and_crosses_itself_less() -> None:
    """Hips that only restored their volume stretched the skin, and thighs sank into calves behind bent knees."""
    means = []
    for body in bodies().values():
        rest = volume(body.vertices, body.faces), vertex_areas(body.vertices, body.faces).sum()
        rows = np.array([figures(body, pose) for pose in sample_poses(24, 7)])  # no seed of the fit or the benchmark
        means.append([*np.abs(rows[:, :2] / rest - 1.0).mean(axis=0), rows[:, 2].mean()])
    before, after = np.array(means)
    assert (before > [0.015, 0.015, 50.0]).all()
    assert (after < before * [0.75, 0.85, 0.95]).all()


def test_shown_shoulders_slope(body: BakedBody) -> None:
    """With the arms down, the skin beside a shoulder's joint was as high as above it: the shoulder was square."""
    drops = []
    for found in bodies().values():
        posed = found.posed(rotations(NAMED["arms down"]))
        above, beside = (_height(posed[found.faces], x, found.joints[16, 2]) for x in (0.13, 0.20))
        drops.append(above - beside)
    assert drops[1] > drops[0] + 0.012


def _height(corners: np.ndarray, x: float, z: float) -> float:
    """Return the highest y of a skin's (T, 3, 3) triangles at x and z in metres."""
    edges = corners[:, 1:, ::2] - corners[:, :1, ::2]
    edges += 1e-12 * np.eye(2)
    shares = np.linalg.solve(np.swapaxes(edges, 1, 2), ((x, z) - corners[:, 0, ::2])[..., None])[..., 0]
    inside = (shares >= 0.0).all(axis=1) & (shares.sum(axis=1) <= 1.0)
    rises = corners[:, 1:, 1] - corners[:, :1, 1]
    return float((corners[:, 0, 1] + (shares * rises).sum(axis=1))[inside].max())


@pytest.mark.slow
def test_rebuilding_gives_the_committed_file() -> None:
    with np.load(BODY_FILE) as data:
        rebuilt = build_shown({key: data[key] for key in data.files})
    with np.load(SHOWN_FILE) as data:
        assert set(data.files) == set(rebuilt)
        for key, value in rebuilt.items():
            if value.dtype.kind == "f":
                np.testing.assert_allclose(value, data[key], rtol=0, atol=1e-4, err_msg=key)
            else:
                np.testing.assert_array_equal(value, data[key], err_msg=key)
