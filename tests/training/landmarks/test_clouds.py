"""The stream's clouds are those of the body, spoiled as it is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from solver_backend.body.body import load_body  # noqa: E402
from solver_backend.body.landmarks import pose_landmarks  # noqa: E402
from solver_backend.body.markers import marker_landmarks  # noqa: E402
from solver_backend.geometry.rotations import exp_so3  # noqa: E402
from solver_backend.labelling.outputs import GHOST, LANDMARKS, MARKERS, other_side  # noqa: E402
from training.landmarks.cloud_stream import (  # noqa: E402  # noqa: E402
    PLACES,
    BodyPoints,
    Clouds,
    CloudStream,
    Corruption,
    Variety,
    rodrigues,
)

PLAIN = Variety(layouts=False, ghosts=False, noise=False, pose_noise=0.0, exchanged=0.0, tilted=0.0)


@pytest.fixture(scope="module")
def stream() -> CloudStream:
    return CloudStream(load_body(), "cpu")


def poses(count: int = 64):
    return 0.3 * torch.randn(count, 22, 3, generator=torch.Generator().manual_seed(1))


def test_places_and_joints_are_those_of_the_body():
    body, rng = load_body(), np.random.default_rng(0)
    rotvec, betas, offsets = rng.normal(0, 0.4, (2, 22, 3)), rng.normal(size=10), rng.normal(0, 0.01, (len(PLACES), 3))
    root, local = exp_so3(rotvec[:, 0]), exp_so3(rotvec[:, 1:])
    true = pose_landmarks(body, marker_landmarks(body, PLACES), betas, root, local, np.zeros((2, 3)), offsets=offsets)
    R = rodrigues(torch.as_tensor(rotvec, dtype=torch.float32))
    to = lambda a: torch.as_tensor(np.broadcast_to(a, (2, *a.shape)).copy(), dtype=torch.float32)  # noqa: E731
    places, joints = BodyPoints(body, "cpu")(R[:, 0], R[:, 1:], to(betas), to(offsets))
    assert np.abs(places.numpy() - true.points).max() < 1e-5
    assert np.abs(joints.numpy() - true.skeleton.joints).max() < 1e-5


def test_the_same_seed_makes_the_same_clouds(stream):
    torch.manual_seed(5)
    a = stream.draw(poses())
    torch.manual_seed(5)
    b = stream.draw(poses())
    assert torch.equal(a.points, b.points) and torch.equal(a.labels, b.labels)


def test_labels_name_the_points_that_are_there_and_no_marker_twice(stream):
    torch.manual_seed(0)
    clouds = stream.draw(poses())
    assert torch.equal(clouds.labels >= 0, clouds.seen) and clouds.labels.max() == GHOST
    for row in clouds.labels:
        markers = row[(row >= 0) & (row < GHOST)].tolist()
        assert len(set(markers)) == len(markers)
    assert clouds.points.isfinite().all() and clouds.targets.shape == (64, len(LANDMARKS), 3)


def test_points_are_near_their_targets_and_medians_at_the_origin(stream):
    torch.manual_seed(0)
    clouds = stream.draw(poses())
    marker = (clouds.labels >= 0) & (clouds.labels < GHOST)
    truth = clouds.targets.gather(1, clouds.labels.clamp(0, GHOST - 1)[..., None].expand(-1, -1, 3))
    assert (clouds.points - truth)[marker].abs().max() < 0.03
    ordered = torch.where(clouds.seen[..., None], clouds.points, torch.inf).sort(dim=1).values
    middle = (clouds.seen.sum(1) - 1) // 2
    assert ordered[torch.arange(64), middle].abs().max() < 1e-6


def test_without_any_spoiling_the_cloud_is_the_markers():
    torch.manual_seed(0)
    clouds = CloudStream(load_body(), "cpu", PLAIN).draw(poses())
    hidden = 53 - clouds.seen.sum(1)
    assert hidden.min() >= 0 and hidden.max() <= 10 and hidden.max() > 0  # 4.23
    marker = clouds.labels >= 0
    truth = clouds.targets.gather(1, clouds.labels.clamp(min=0)[..., None].expand(-1, -1, 3))
    assert (clouds.points - truth)[marker].abs().max() < 1e-6


def test_of_few_markers_one_is_never_hidden():
    """An empty cloud has no middle: without ghosts, training went to NaN at the first one."""
    torch.manual_seed(0)
    worn = torch.zeros(200, len(PLACES), dtype=torch.bool)
    worn[:, [3, 8, 40]] = True
    seen = Corruption("cpu", ghosts=False)(torch.zeros(200, len(PLACES), 3), worn).seen
    assert seen.sum(1).min() == 1 and seen.sum(1).max() == 3
    assert not seen[:, ~worn[0, :GHOST]].any()


def test_ghosts_have_the_mean_and_covariance_of_the_visible():
    torch.manual_seed(0)
    points = torch.randn(1, GHOST, 3) @ torch.diag(torch.tensor([0.3, 0.2, 0.6])) + 1.0
    spoil = Corruption("cpu")
    seen = torch.arange(GHOST) < 30
    ghosts = spoil.gaussian(points.expand(20000, -1, -1), seen.expand(20000, -1)).flatten(0, 1)
    assert torch.allclose(ghosts.mean(0), points[0, seen].mean(0), atol=0.01)
    assert torch.allclose(ghosts.T.cov() / 1.2**2, points[0, seen].T.cov(), atol=0.01)


def test_the_other_side_of_the_other_side_is_oneself():
    for name in (*PLACES, "left_hand", "pelvis"):
        assert other_side(other_side(name)) == name
    assert (other_side("LASI") if "LASI" in PLACES else other_side("LFWT"))[0] == "R"
    assert other_side("C7") == "C7" and other_side("RBAC") == "LBAC" and other_side("left_knee") == "right_knee"
    assert len(MARKERS) == 53


def test_some_people_wear_markers_on_a_part_of_the_body_alone() -> None:
    torch.manual_seed(0)
    everywhere = Variety(ghosts=False, noise=False, thinned=0.0, parts=0.0)
    whole = CloudStream(load_body(), "cpu", everywhere).draw(poses(400))
    cut = CloudStream(load_body(), "cpu", replace(everywhere, parts=1.0)).draw(poses(400))
    legs = [i for i, name in enumerate(MARKERS) if name.endswith(("KNE", "ANK", "HEE"))]
    arms = [i for i, name in enumerate(MARKERS) if name.endswith(("ELB", "WRA", "FIN"))]

    def lacking(clouds: Clouds, which: list[int]) -> float:
        return float((~torch.isin(clouds.labels, torch.tensor(which)).any(1)).float().mean())

    assert lacking(whole, legs) < 0.02 and lacking(whole, arms) < 0.05
    assert lacking(cut, legs) > 0.1 and lacking(cut, arms) > 0.2
