"""Axes, gaps and thinning of the plots."""

from __future__ import annotations

import re

import numpy as np
import pytest

from solver_backend.report.markup import tints
from solver_backend.report.plots import MAX_POINTS, PlotCurve, nice_steps, strip_plot, thinned, time_plot


@pytest.mark.parametrize(("low", "high"), [(0, 1), (-3.2, 7.9), (0, 1e-7), (120, 121), (5, 5), (0, 98765)])
def test_steps_are_round_and_cover_the_range(low, high):
    steps = nice_steps(low, high)
    assert steps[0] <= low + 1e-9
    assert steps[-1] >= high - 1e-9
    assert 2 <= len(steps) <= 8
    gaps = np.diff(steps)
    np.testing.assert_allclose(gaps, gaps[0], rtol=1e-3)


def test_a_gap_lifts_the_pen():
    values = np.arange(10.0)
    values[4:6] = np.nan
    path = re.search(r'class="line a" d="([^"]*)"', time_plot([PlotCurve(values, "x")], 10.0, "m")).group(1)
    assert path.count("M") == 2
    assert path.count("L") == 6


def test_a_curve_without_values_is_drawn_empty():
    assert 'd=""' in time_plot([PlotCurve(np.full(5, np.nan), "x")], 10.0, "m")


def test_thinning_keeps_every_spike():
    rng = np.random.default_rng(0)
    values = rng.normal(size=20_000)
    spikes = [5, 7001, 19_999]
    values[spikes] = [50.0, -60.0, 70.0]
    frames, kept = thinned(values)
    assert len(kept) <= MAX_POINTS
    assert set(spikes) <= set(frames.tolist())
    assert (np.diff(frames) > 0).all()
    np.testing.assert_array_equal(values[frames], kept)


def test_strips_cover_all_frames_once():
    values = np.array([1, 1, 0, 0, 0.5, 1.0])
    svg = strip_plot([("camera", values)], 10.0)
    cells = [tuple(map(float, m)) for m in re.findall(r'class="cell" x="([\d.]+)" width="([\d.]+)"', svg)]
    assert len(cells) == 4
    ends = [x + width for x, width in cells]
    np.testing.assert_allclose(ends[:-1], [x for x, _ in cells[1:]], atol=0.02)
    assert [int(h) for h in re.findall(r"--h:(\d+)%", svg)] == [100, 0, 50, 100]


def test_tints_separate_3_from_8_pixels_of_any_take() -> None:
    for usual in (2.0, 3.0, 5.0, 8.0):
        three, eight = tints(np.array([3.0, 8.0]), usual)
        assert eight - three >= 0.2 and 0.0 <= three < eight <= 1.0
    assert tints(np.array([0.0]), 3.0)[0] == 0.0
