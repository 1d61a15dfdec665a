"""Pose-NDF's training: true distances, negatives, losses, stages, a killed run, and what is exported."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.progress import silent
from solver_backend.geometry.quaternions import matrix_from_quat, quat_from_rotvec
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.joint_spread import JointSpread
from solver_backend.priors.pose_ndf.pose_distance import pose_distance
from solver_backend.priors.pose_ndf.pose_ndf import in_metric, load_pose_ndf, metric_length
from solver_backend.training.data.corpus import Corpus, build_corpus
from solver_backend.training.data.sources.clips import Clip
from solver_backend.training.engine.loop import TrainingSettings
from solver_backend.training.engine.recipe import Job
from solver_backend.training.pose_ndf.nearest_poses import NearestPoses, unit_quats
from solver_backend.training.pose_ndf.negatives import (
    NOBODY,
    Labelled,
    Poses,
    RecordedPoses,
    blended,
    labelled,
    projected,
    spread,
    turned,
)
from solver_backend.training.pose_ndf.network import (
    PoseFieldNet,
    PoseNdfSettings,
    PoseNdfTask,
    as_prior,
    field_arrays,
    upper,
)
from solver_backend.training.pose_ndf.stages import manifold_of, possible_frames
from solver_backend.training.pose_ndf.train import train_pose_ndf
from tests.training.test_sposer_training import DATA

SMALL = PoseNdfSettings(
    features=3,
    encoder_hidden=4,
    field_hidden=(16, 16),
    pool=120,
    validation=200,
    samples=20,
)


def swaying(seed: int, frames: int = 60) -> Corpus:
    rng = np.random.default_rng(seed)
    phase, amplitude = rng.uniform(0, 6, (21, 3)), 0.15 * rng.standard_normal((21, 3))
    time = np.arange(frames)[:, None, None] / 30.0
    sways = [exp_so3(k * amplitude * np.sin(4 * time + phase)).astype(np.float32) for k in (1.0, 1.1)]
    return build_corpus([Clip(f"test/{who}", who, R) for who, R in zip(("01", "02"), sways, strict=True)])


def job(folder: Path, steps: int, checkpoint_s: float = 60.0) -> Job:
    settings = TrainingSettings(steps=steps, batch=32, evaluate_every=3, checkpoint_s=checkpoint_s, learning_rate=3e-3)
    return Job(swaying(0), swaying(1), settings, folder, folder / "run", "train", DATA, silent)


def random_quats(count: int, seed: int, scale: float = 0.5) -> torch.Tensor:
    rng = np.random.default_rng(seed)
    return torch.as_tensor(quat_from_rotvec(scale * rng.standard_normal((count, 21, 3))), dtype=torch.float32)


@pytest.mark.parametrize("scale", [0.1, 0.8])
def test_nearest_poses_against_comparing_all(scale: float) -> None:
    poses, queries = random_quats(700, 0), random_quats(40, 1, scale)
    every = pose_distance(queries[:, None].double(), poses[None].double()).sort(dim=1)
    nearest = NearestPoses(poses)
    np.testing.assert_allclose(nearest.distances(queries).numpy(), every.values[:, :5].numpy(), rtol=3e-3)
    np.testing.assert_allclose(nearest.mean_distance(-queries).numpy(), every.values[:, :5].mean(1).numpy(), rtol=3e-3)
    assert (nearest.nearest(poses[:50]) == torch.arange(50)).all()


def test_turned_poses_lie_as_far_as_they_are_turned() -> None:
    manifold, generator = RecordedPoses.of(random_quats(50, 0), torch.arange(50)), torch.Generator().manual_seed(0)
    near, far = (
        turned(manifold.drawn(300, generator), spread(300, degrees, generator), generator)
        for degrees in ((1.0, 2.0), (30.0, 60.0))
    )
    nearest = [manifold.nearest.distances(poses.quats, 1)[:, 0].median() for poses in (near, far)]
    assert 0.03 < nearest[0] < 0.08 and 1.0 < nearest[1] < 2.2
    mixed = blended(manifold, 100, generator)
    np.testing.assert_allclose(torch.linalg.vector_norm(mixed.quats, dim=-1).numpy(), 1.0, rtol=1e-6)
    assert (mixed.people == NOBODY).all()


def test_distances_are_to_the_poses_of_other_people() -> None:
    quats, people = random_quats(90, 0), torch.arange(90) % 3
    manifold = RecordedPoses.of(quats, people)
    asked = Poses(random_quats(12, 1), torch.tensor([0, 1, 2, NOBODY] * 3))
    found = labelled(asked, manifold).distance
    for pose, who, distance in zip(asked.quats, asked.people, found, strict=True):
        every = pose_distance(pose.double(), quats[people != who].double()).sort().values[:5].mean()
        assert float(distance) == pytest.approx(float(every), rel=3e-3)
    own = Poses(quats, people)
    assert labelled(own, manifold).distance.min() > 0.5 > manifold.nearest.distances(quats, 1).max()
    alone = swaying(0)
    with pytest.raises(JobInvalid, match="several people"):
        manifold_of(replace(alone, subjects=("01", "01")))


def test_keyed_clips_are_people_of_their_own_and_the_unknown_one() -> None:
    poses = swaying(0).rotations
    names = ("keyed/roll", "keyed/sit", "expmap/a", "expmap/b", "mb2/02_01", "mb2/02_02")
    who = ("keyed", "keyed", "unknown", "unknown", "02", "02")
    parts = np.array_split(poses, len(names))
    corpus = build_corpus([Clip(n, s, part) for n, s, part in zip(names, who, parts, strict=True)])
    firsts = corpus.people[np.unique(corpus.clip_start)]
    assert firsts[2] == firsts[3] and firsts[4] == firsts[5] and len(set(firsts.tolist())) == 4


def test_poses_out_of_reach_are_no_part_of_the_manifold() -> None:
    corpus = swaying(0)
    bent = corpus.rotations.copy()
    bent[corpus.distinct[0], 14] = exp_so3(np.array([0.0, 3.0, 0.0]))  # the head looks backwards
    assert len(possible_frames(replace(corpus, rotations=bent))) == len(np.unique(corpus.distinct)) - 1
    manifold = manifold_of(corpus)
    assert len(manifold.quats) == len(manifold.people) == 2 * len(possible_frames(corpus))
    assert manifold.nearest.distances(manifold.quats[-5:], 1).max() < 1e-3


def test_a_distance_solves_the_eikonal_equation() -> None:
    """The distance to one pose has a gradient of unit length in its own metric: the eikonal equation."""
    quats = upper(random_quats(20, 2).double()).requires_grad_()
    rest = torch.zeros_like(quats)
    rest[..., 0] = 1.0
    distance = pose_distance(quats, rest)
    (gradient,) = torch.autograd.grad(distance.sum(), quats)
    np.testing.assert_allclose(metric_length(in_metric(quats, gradient)).detach().numpy(), 1.0, rtol=1e-7)


def test_field_gradient_flows_to_every_parameter() -> None:
    torch.manual_seed(0)
    net, quats = PoseFieldNet(SMALL), upper(random_quats(32, 3))
    poses = Labelled(quats, NearestPoses(random_quats(60, 4)).mean_distance(quats))
    task = PoseNdfTask(net, lambda: poses, poses, SMALL, 32)
    task.loss(0, torch.Generator().manual_seed(0)).backward()
    assert all(p.grad is not None and float(p.grad.abs().sum()) > 0 for p in net.parameters())
    assert -1 <= task.evaluate(net)["spearman"] <= 1


def test_projected_poses_lie_nearer_than_they_started(tmp_path: Path) -> None:
    torch.manual_seed(0)
    manifold = RecordedPoses.of(random_quats(30, 5), torch.arange(30))
    prior = as_prior(PoseFieldNet(SMALL), manifold.spread)
    met = projected(prior, manifold, 31, torch.Generator().manual_seed(0))
    assert met.quats.shape == (30, 21, 4) and int((met.people == NOBODY).sum()) == 10
    np.testing.assert_allclose(torch.linalg.vector_norm(met.quats, dim=-1).numpy(), 1.0, rtol=1e-5)


def test_training_learns_and_exports_what_it_learned(tmp_path: Path) -> None:
    finished = train_pose_ndf(job(tmp_path, 120), SMALL)
    assert finished.metrics["spearman"] > 0.8 and finished.metrics["predicted_lowered_percent"] > 95
    prior = load_pose_ndf(finished.weights)
    card = finished.weights.with_suffix(".md").read_text(encoding="utf-8")
    assert prior.metadata["sha256"] in card and "samples_outside_percent" in card and "mean over the 5" in card
    assert prior.metadata["field_size"]["field_hidden"] == [16, 16]


def test_exported_weights_give_the_trained_field() -> None:
    torch.manual_seed(0)
    net, quats = PoseFieldNet(SMALL), upper(random_quats(9, 6))
    arrays = field_arrays(net)
    assert arrays["field_w0"].dtype == np.float16 and arrays["field_b0"].dtype == np.float32
    for name, value in {"w0": net.w0, "w1": net.w1}.items():
        np.testing.assert_allclose(arrays[f"encoder_{name}"], value.detach().numpy(), atol=2e-3)
    spread = JointSpread(np.zeros((21, 3)), np.zeros((21, 3, 3)))
    assert as_prior(net, spread).distance_with_gradient(quats.flatten(1))[0].requires_grad is False


def test_a_killed_run_resumes_to_the_same_loss_curve_and_weights(tmp_path: Path, monkeypatch) -> None:
    whole = train_pose_ndf(job(tmp_path / "whole", 40), SMALL)
    plain, calls = PoseNdfTask.loss, [0]

    def dying(self: PoseNdfTask, step: int, generator: torch.Generator) -> torch.Tensor:
        calls[0] += 1
        if calls[0] in (5, 14, 27):
            raise KeyboardInterrupt
        return plain(self, step, generator)

    monkeypatch.setattr(PoseNdfTask, "loss", dying)
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            train_pose_ndf(job(tmp_path / "killed", 40, checkpoint_s=0.0), SMALL)
    again = train_pose_ndf(job(tmp_path / "killed", 40, checkpoint_s=0.0), SMALL)
    for stage in range(1, 4):
        logs = [tmp_path / run / "run" / f"stage{stage}" / "log.jsonl" for run in ("whole", "killed")]
        curves = [log.read_text(encoding="utf-8").splitlines() for log in logs]
        assert curves[0] == curves[1] and len(curves[0]) >= 2
    first, second = (np.load(x.weights, allow_pickle=False) for x in (whole, again))
    assert all(np.array_equal(first[key], second[key]) for key in first.files if key != "header")


def test_unit_quats_are_the_rotations() -> None:
    quats = random_quats(5, 7)
    assert float(pose_distance(unit_quats(matrix_from_quat(quats)), quats).max()) < 2e-3
