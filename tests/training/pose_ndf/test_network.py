"""The network's losses, gradients and exported weights."""

from __future__ import annotations

import numpy as np
import torch

from solver_backend.geometry.rotations import upper_hemisphere
from solver_backend.priors.pose_ndf import JointSpread, in_metric, metric_length, pose_distance
from tests.support.swaying_people import SMALL, random_quats
from training.pose_ndf.negatives import (
    Labelled,
    NearestPoses,
)
from training.pose_ndf.network import (
    PoseFieldNet,
    PoseNdfTask,
    as_prior,
    field_arrays,
)


def test_a_distance_solves_the_eikonal_equation() -> None:
    """The distance to one pose has a gradient of unit length in its own metric: the eikonal equation."""
    quats = upper_hemisphere(random_quats(20, 2).double()).requires_grad_()
    rest = torch.zeros_like(quats)
    rest[..., 0] = 1.0
    distance = pose_distance(quats, rest)
    (gradient,) = torch.autograd.grad(distance.sum(), quats)
    np.testing.assert_allclose(metric_length(in_metric(quats, gradient)).detach().numpy(), 1.0, rtol=1e-7)


def test_field_gradient_flows_to_every_parameter() -> None:
    torch.manual_seed(0)
    net, quats = PoseFieldNet(SMALL), upper_hemisphere(random_quats(32, 3))
    poses = Labelled(quats, NearestPoses(random_quats(60, 4)).mean_distance(quats))
    task = PoseNdfTask(net, lambda: poses, poses, SMALL, 32)
    generator = torch.Generator().manual_seed(0)
    task.loss(task.draw(generator), generator).backward()
    assert all(p.grad is not None and float(p.grad.abs().sum()) > 0 for p in net.parameters())
    assert -1 <= task.evaluate(net)["spearman"] <= 1


def test_exported_weights_give_the_trained_field() -> None:
    torch.manual_seed(0)
    net, quats = PoseFieldNet(SMALL), upper_hemisphere(random_quats(9, 6))
    arrays = field_arrays(net)
    assert arrays["field_w0"].dtype == np.float16 and arrays["field_b0"].dtype == np.float32
    for name, value in {"w0": net.w0, "w1": net.w1}.items():
        np.testing.assert_allclose(arrays[f"encoder_{name}"], value.detach().numpy(), atol=2e-3)
    spread = JointSpread(np.zeros((21, 3)), np.zeros((21, 3, 3)))
    assert as_prior(net, spread).distance_with_gradient(quats.flatten(1))[0].requires_grad is False
