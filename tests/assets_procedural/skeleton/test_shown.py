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
from assets_procedural.skeleton.skinning import volume
from tests.support.shown_body import NAMED, bodies, crossing


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


def test_the_shown_body_barely_crosses_itself_more_than_the_solvers() -> None:
    """Hips that swelled up to the crotch pushed the skin through itself: 137 faces per pose here, 104 without."""
    poses = sample_poses(16, 7)  # neither the seed of the fit nor of the benchmark
    before, after = (sum(crossing(body, body.posed(pose)) for pose in poses) for body in bodies().values())
    assert before > 16 * 50 and after < 1.06 * before


def test_shown_shoulders_slope(body: BakedBody) -> None:
    """With the arms down, the skin beside a shoulder's joint was as high as above it: the shoulder was square."""
    drops = []
    for found in bodies().values():
        posed = found.posed(rotations(NAMED["arms down"]))
        upper = posed[(posed[:, 1] > 0.3) & (np.abs(posed[:, 2] - found.joints[16, 2]) < 0.03)]
        height = [upper[np.abs(upper[:, 0] - x) < 0.012, 1].max() for x in (0.13, 0.20)]
        drops.append(height[0] - height[1])
    assert drops[1] > drops[0] + 0.008


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
