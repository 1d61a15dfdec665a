"""Test keys that are closer together where a motion is fast."""

from __future__ import annotations

import numpy as np

from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from tests.benchmarks.denser_keys import denser_where_fast


def test_as_many_keys_stand_closer_where_the_points_are_fast() -> None:
    rng = np.random.default_rng(4)
    speed = np.where(np.arange(240) < 120, 0.002, 0.02)
    points = np.cumsum(speed)[:, None, None] + 0.0001 * rng.normal(size=(240, 25, 3))
    points[rng.random((240, 25)) < 0.1] = np.nan
    even = KeyframeLayout.even(240, 20)
    layout = denser_where_fast(even, points, 0.5)
    lengths = np.diff(layout.bounds)
    assert layout.num_keys == even.num_keys and (layout.bounds[[0, -1]] == even.bounds[[0, -1]]).all()
    assert lengths[:3].min() > 1.5 * lengths[-6:].max() and lengths.min() >= 9 and lengths.max() <= 41
    even, steady = KeyframeLayout.even(241, 20), np.broadcast_to(np.arange(241.0)[:, None, None], (241, 25, 3))
    assert (denser_where_fast(even, steady, 1.0).bounds == even.bounds).all()
