"""The thesis' clouds are spoiled as its eqs. 4.20 to 4.27 and its paper's appendix C say, and in no other way."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from solver_backend.body.body import load_body  # noqa: E402
from solver_backend.labelling.outputs import GHOST, LANDMARKS, MARKERS  # noqa: E402
from training.landmarks.cloud_stream import (  # noqa: E402
    DOMINANT,
    PLACES,
    CloudStream,
    ThesisCorruption,
    thesis_shapes,
)
from training.landmarks.rows import CLOUDS, FIXED, THESIS  # noqa: E402

COUNT = 4000


def worn(count: int = COUNT):
    on = torch.zeros(count, len(PLACES), dtype=torch.bool)
    on[:, : len(MARKERS)] = True
    return on


def places(count: int = COUNT):
    one = torch.randn(1, len(PLACES), 3, generator=torch.Generator().manual_seed(2)) * torch.tensor([0.3, 0.2, 0.6])
    return (one + 1.0).expand(count, -1, -1)


def spoiled(**chances: float):
    torch.manual_seed(0)
    only = {"hidden_chance": 0.0, "ghost_chance": 0.0, "noise_chance": 0.0} | chances
    return ThesisCorruption("cpu", **only)(places(), worn())


def test_without_its_three_mechanisms_nothing_is_spoiled():
    clouds = spoiled()
    assert clouds.seen.sum(1).eq(GHOST).all()
    assert torch.equal(clouds.points[:, :GHOST], places()[:, :GHOST])


def test_occlusion_hides_k_of_m_to_n_prime_markers():
    hidden = GHOST - spoiled(hidden_chance=1.0).seen.sum(1)
    counts = torch.bincount(hidden, minlength=11).float() / COUNT
    assert hidden.max() == 10 and counts.sub(1 / 11).abs().max() < 0.02
    assert (GHOST - spoiled(hidden_chance=0.7).seen.sum(1) == 0).float().mean() == pytest.approx(
        0.3 + 0.7 / 11, abs=0.03
    )


def test_ghosts_are_drawn_from_the_median_and_the_covariance_of_the_remaining():
    spoil = ThesisCorruption("cpu")
    seen = (torch.arange(GHOST) < 30).expand(20000, -1)
    torch.manual_seed(0)
    points = places(20000)[:, :GHOST]
    ghosts = spoil.ghosts(points, seen).flatten(0, 1)
    remaining = points[0, :30]
    ordered = remaining.sort(0).values
    assert torch.allclose(ghosts.mean(0), 0.5 * (ordered[14] + ordered[15]), atol=0.01)
    assert not torch.allclose(ghosts.mean(0), remaining.mean(0), atol=0.01)
    assert torch.allclose(ghosts.T.cov(), remaining.T.cov(), atol=0.01)


def test_ghosts_come_at_the_papers_chance_and_carry_no_name():
    clouds = spoiled(ghost_chance=0.7)
    more = clouds.seen[:, GHOST:].sum(1)
    assert (more > 0).float().mean() == pytest.approx(0.7, abs=0.03)
    assert clouds.labels[:, GHOST:][clouds.seen[:, GHOST:]].eq(GHOST).all()


def test_noise_moves_n_markers_within_a_cube_and_leaves_the_others():
    clouds = spoiled(noise_chance=1.0)
    off = clouds.points[:, :GHOST] - places()[:, :GHOST]
    moved = off.abs().amax(-1) > 0
    assert off.abs().max() <= 0.02 and off[moved].std() == pytest.approx(0.02 / 3**0.5, rel=0.02)
    counts = moved.sum(1)
    assert counts.min() == 1 and counts.max() == GHOST and counts.float().mean() == pytest.approx(27, abs=1.0)


def test_shapes_are_shifted_by_one_number_and_the_dominant_ones_drawn_anew():
    torch.manual_seed(0)
    base = torch.zeros(COUNT, 10)
    found = thesis_shapes(base, shift_chance=1.0, redraw_chance=0.0)
    assert torch.equal(found, found[:, :1].expand(-1, 10)) and found.abs().max() <= 1.0  # 4.20
    anew = thesis_shapes(base, shift_chance=0.0, redraw_chance=1.0)  # 4.21
    assert anew[:, DOMINANT:].eq(0).all()
    number = anew[:, :DOMINANT].ne(0).sum(1)
    assert set(number.tolist()) == {0, 1, 2, 3}
    assert anew[anew.ne(0)].std() == pytest.approx(1.0, abs=0.05)
    assert (thesis_shapes(base)[:, -1] != 0).float().mean() == pytest.approx(0.5, abs=0.03)


def test_the_thesis_clouds_have_no_sizes_props_tilts_or_strayed_markers():
    assert CLOUDS == {"thesis": THESIS, "fixed": FIXED} and THESIS != FIXED
    stream = CloudStream(load_body(), "cpu", THESIS)
    torch.manual_seed(0)
    stream.corruption = ThesisCorruption("cpu", hidden_chance=0.0, ghost_chance=0.0, noise_chance=0.0)
    clouds = stream.draw(torch.zeros(500, 22, 3))
    assert clouds.seen.shape == (500, GHOST) and clouds.seen.all()
    assert torch.allclose(clouds.points, clouds.targets[:, :GHOST], atol=1e-6)
    up = clouds.targets[:, LANDMARKS.index("head")] - clouds.targets[:, LANDMARKS.index("pelvis")]
    assert (up[:, :2].norm(dim=-1) / up[:, 2]).std() < 0.02
    drawn = CloudStream(load_body(), "cpu", THESIS).draw(torch.zeros(500, 22, 3))
    assert drawn.seen.sum(1).max() <= GHOST + ThesisCorruption("cpu").most_ghosts
