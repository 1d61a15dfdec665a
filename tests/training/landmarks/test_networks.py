"""The networks beside each other: what they draw, read and cost."""

from __future__ import annotations

import math

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from solver_backend.body.body import load_body  # noqa: E402
from training.landmarks.cloud_stream import CloudStream  # noqa: E402
from training.landmarks.models import (  # noqa: E402  # noqa: E402
    PUBLISHED,
    SIGMA_PX,
    DemocapLike,
    FromCoordinates,
    Ours,
    PointNetWidths,
    Published,
    UNet,
    balanced_mse,
    depth_maps,
    divergence_from_gaussians,
    drawn,
    front_and_back,
    fused,
    gaussians_near,
    read_maps,
    relative_entropy,
    spread_loss,
    welsch,
    y_up,
)
from training.landmarks.rows import FIXED, evaluate  # noqa: E402


@pytest.fixture(scope="module")
def clouds():
    torch.manual_seed(0)
    return CloudStream(load_body(), "cpu", FIXED).draw(0.3 * torch.randn(2, 22, 3))


def test_a_marker_is_drawn_where_it_is_and_as_near_as_it_is():
    points = torch.tensor([[[0.5, -0.25, 0.8], [0.5, -0.25, -0.8], [-0.5, 0.25, 0.0]]])
    seen = torch.ones(1, 3, dtype=torch.bool)
    maps = depth_maps(points, seen, 81)
    (row, column), (high, left) = (round(0.375 * 80), round(0.75 * 80)), (round(0.625 * 80), round(0.25 * 80))
    assert maps[0, 0, row, column] == pytest.approx(1.0)  # the nearer of the two
    assert maps[0, 0, high, left] == pytest.approx(0.55)  # halfway
    assert (maps[0, 0] > 0).sum() == 18 and (maps[0, 1] > 0).sum() == 27
    # The other view looks along +x.
    assert maps[0, 1, row, round(0.9 * 80)] == pytest.approx(0.1) and maps[0, 1, high, 40] == pytest.approx(1.0)
    back = front_and_back(points, seen, 81)[0, 1]
    assert back[row, column] == pytest.approx(1.0) and back[high, left] == pytest.approx(0.55)
    assert (depth_maps(points, torch.zeros(1, 3, dtype=torch.bool), 81) == 0).all()


def test_no_view_is_a_mirror_image_of_another():
    draw = torch.Generator().manual_seed(0)
    points, seen = 0.8 * (2.0 * torch.rand(1, 20, 3, generator=draw) - 1.0), torch.ones(1, 20, dtype=torch.bool)
    x, y, z = points.unbind(-1)
    turned = torch.stack((z, y, -x), -1)  # a quarter turn about y, a rotation
    assert torch.allclose(depth_maps(turned, seen, 64)[:, 0], depth_maps(points, seen, 64)[:, 1], atol=1e-6)


def test_gravity_lies_along_y(clouds):
    assert torch.equal(y_up(clouds.targets)[..., 1], clouds.targets[..., 2])
    points, seen, frame, targets = drawn(clouds)
    assert points[seen].abs().max() <= 1.0 and torch.allclose(frame.metres(targets), y_up(clouds.targets), atol=1e-6)


def gaussian_heatmaps(u, v, size):
    """Return (..., size, size) maps that sum to 1, about (...) coordinates in -1..1; rows along v."""
    pixels, sigma = torch.linspace(-1.0, 1.0, size), 2.0 * SIGMA_PX / (size - 1)
    down, across = (torch.softmax(-0.5 * ((pixels - c.clamp(-1.0, 1.0)[..., None]) / sigma) ** 2, -1) for c in (v, u))
    return down[..., :, None] * across[..., None, :]


def jensen_shannon(a, b):
    """Return the divergence of (..., H, W) maps that sum to 1 (thesis eq. 4.14), in nats."""
    middle = (0.5 * (a + b) + 1e-12).log()
    return 0.5 * (a * ((a + 1e-12).log() - middle) + b * ((b + 1e-12).log() - middle)).sum((-2, -1))


def test_heatmaps_are_read_where_they_were_drawn():
    where = 0.8 * (2.0 * torch.rand(3, 5, 3, generator=torch.Generator().manual_seed(0)) - 1.0)
    views = torch.stack((where[..., 0], where[..., 2]), 1), torch.stack((where[..., 1],) * 2, 1)
    maps = gaussian_heatmaps(*views, 160)
    assert torch.allclose(maps.sum((-2, -1)), torch.ones(3, 2, 5), atol=1e-5)
    reading = read_maps((maps + 1e-30).log())
    assert (fused(reading) - where).abs().max() < 1e-3
    assert (reading.across - views[0]).abs().max() < 1e-3


def test_a_reading_is_that_of_the_softmax_and_so_is_its_derivative():
    draw = torch.Generator().manual_seed(1)
    logits = 3.0 * torch.randn(2, 3, 16, 16, generator=draw) + 100.0
    pixels = torch.randint(256, (2, 3, 7), generator=draw)
    weights = torch.randn(4, 2, 3, generator=draw)

    def plain(logits):
        log_maps, line = logits.flatten(-2).log_softmax(-1), torch.linspace(-1.0, 1.0, 16)
        maps = log_maps.exp().view(logits.shape)
        total = logits.flatten(-2).logsumexp(-1)
        return (maps.sum(-2) * line).sum(-1), (maps.sum(-1) * line).sum(-1), total, log_maps.gather(-1, pixels).sum(-1)

    def read(logits):
        reading = read_maps(logits, pixels)
        return reading.across, reading.down, reading.log_total, reading.log_near.sum(-1)

    found = []
    for reader in (plain, read):
        leaf = logits.clone().requires_grad_()
        values = torch.stack(reader(leaf))
        (weights * values).sum().backward()
        found.append((values, leaf.grad))
    assert torch.allclose(found[0][0], found[1][0], atol=1e-4)
    assert torch.allclose(found[0][1], found[1][1], atol=1e-5)


def test_divergence_is_zero_for_equal_maps_and_log_2_for_those_apart():
    a = gaussian_heatmaps(torch.tensor([-0.5]), torch.tensor([0.0]), 160)
    b = gaussian_heatmaps(torch.tensor([0.5]), torch.tensor([0.0]), 160)
    assert jensen_shannon(a, a).abs().max() < 1e-5
    assert jensen_shannon(a, b)[0] == pytest.approx(math.log(2.0), abs=1e-3)


@pytest.mark.parametrize("size", [16, 48, 160])
def test_the_divergence_from_gaussians_is_that_of_the_whole_maps(size):
    draw = torch.Generator().manual_seed(size)
    where = 2.2 * torch.rand(40, 2, generator=draw) - 1.1  # at the rim and beyond it too
    sharp = 4.0 * torch.randn(40, 1, 1, generator=draw).abs()
    maps = torch.softmax(sharp.flatten(1) * torch.randn(40, size * size, generator=draw), -1).view(40, size, size)
    maps[::2] = 0.5 * maps[::2] + 0.5 * gaussian_heatmaps(where[::2, 0] + 0.02, where[::2, 1], size)
    whole = jensen_shannon(gaussian_heatmaps(where[:, 0], where[:, 1], size), maps)
    near, pixels = gaussians_near(where[:, 0], where[:, 1], size)
    assert torch.allclose(
        divergence_from_gaussians(near, read_maps((maps + 1e-30).log(), pixels).log_near), whole, atol=2e-4
    )


def test_relative_entropy_is_that_of_gaussians_to_the_maps():
    draw = torch.Generator().manual_seed(3)
    where = 1.6 * torch.rand(10, 2, generator=draw) - 0.8
    logits = torch.randn(10, 48, 48, generator=draw)
    log_maps = logits.flatten(1).log_softmax(-1).view(10, 48, 48)
    gaussians = gaussian_heatmaps(where[:, 0], where[:, 1], 48)
    whole = (gaussians * ((gaussians + 1e-12).log() - log_maps)).sum((-2, -1))
    near, pixels = gaussians_near(where[:, 0], where[:, 1], 48)
    assert torch.allclose(relative_entropy(near, read_maps(logits, pixels).log_near), whole, atol=2e-3)


def test_a_map_that_is_surely_wrong_learns_by_relative_entropy_and_not_by_jensen_and_shannon():
    truth, wrong = (torch.tensor([0.5]), torch.tensor([0.0])), (torch.tensor([-0.5]), torch.tensor([0.0]))
    slopes = []
    near, pixels = gaussians_near(*truth, 48)
    for cost in (relative_entropy, divergence_from_gaussians):
        logits = (gaussian_heatmaps(*wrong, 48) + 1e-9).log().requires_grad_()
        cost(near, read_maps(logits, pixels).log_near).sum().backward()
        slopes.append(float(logits.grad.abs().max()))
    assert slopes[0] > 0.01 and slopes[1] < 1e-3 * slopes[0]


def test_welsch_is_4_15():
    e = torch.tensor([[0.03, 0.0, 0.04]])
    assert welsch(torch.zeros(1, 3), e)[0] == pytest.approx(1 - math.exp(-0.0025 / (2 * 0.05**2)))


def test_balanced_mse_prefers_the_own_truth():
    truth = torch.randn(6, 4, 3, generator=torch.Generator().manual_seed(0))
    assert balanced_mse(truth, truth, 0.1) < balanced_mse(truth.roll(1, 0), truth, 0.1)


def test_the_likelihood_is_least_at_the_errors_own_spread():
    errors = 0.5 * torch.randn(4000, 3, generator=torch.Generator().manual_seed(0))

    def mean(log_diagonal: float) -> float:
        spread = torch.zeros(4000, 6)
        spread[:, :3] = log_diagonal
        return float(spread_loss(spread, errors).mean())

    costs = [mean(x) for x in np.linspace(-1.0, 3.0, 41)]
    best = float(np.linspace(-1.0, 3.0, 41)[int(np.argmin(costs))])
    assert 0.6 < math.exp(-best) / 0.5 < 1.1  # Student's scale is below a normal's deviation


@pytest.mark.parametrize("width", [2, 4])
def test_the_unet_keeps_the_size_and_grows_with_the_width(width):
    net = UNet(1, 3, width)
    assert net(torch.zeros(2, 1, 160, 160)).shape == (2, 3, 160, 160)
    assert net.encoders[4].get_submodule("0").out_channels == 16 * width


@pytest.mark.parametrize(
    "make",
    [
        lambda: Ours(PointNetWidths(16, 1, 2)),
        lambda: Published(2),
        lambda: DemocapLike(2, size=48),
        lambda: DemocapLike(2, loss="bmse", size=48),
        lambda: FromCoordinates(8),
    ],
    ids=["ours", "published", "democap-like", "democap-like bmse", "from coordinates"],
)
def test_every_network_learns_one_batch_a_little_and_is_judged(make, clouds):
    torch.manual_seed(0)
    model = make()
    optimizer = torch.optim.AdamW(model.parameters(), 3e-3)
    losses = []
    for _ in range(8):
        loss = model.loss(clouds)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0]
    figures = evaluate(model, [clouds])
    assert figures["rmse3"] == pytest.approx((1 - figures["pck3_all"] / 100) * figures["rmse_mm"])
    assert model.positions(clouds).shape == (2, len(model.columns), 3)


def test_the_published_network_tells_of_53_markers_and_18_joints():
    assert len(PUBLISHED) == 71 and len(set(PUBLISHED)) == 71
