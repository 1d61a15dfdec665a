"""Scores of many sizes of pictures at once are those of each alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.agreement.reading_scores import ReadingScores
from solver_backend.cameras.camera_corrections import CameraCorrection
from solver_backend.synthesis.embedded.demo import demo_capture


@pytest.mark.parametrize("chosen", [(0, 1, 2, 3), (2,)])
@pytest.mark.parametrize("turn", [0, 1])
def test_sizes_score_as_each_does_alone(chosen: tuple[int, ...], turn: int) -> None:
    cameras, keypoints = demo_capture(12, 60.0).require_multiview()
    scores = ReadingScores(cameras, keypoints.xy[:, ::4], keypoints.confidence[:, ::4])
    reading = [CameraCorrection(turn=turn, shape="squeezed" if c == 1 else "") for c in range(len(cameras))]
    sizes = [0.25, 0.5, 1.0, 1.5, 2.0]
    alone = [scores.of([replace(r, factor=f) if c in chosen else r for c, r in enumerate(reading)]) for f in sizes]
    found = scores.of_sizes(reading, sizes, chosen)
    assert np.ptp(found) > 0.02
    np.testing.assert_allclose(found, alone, atol=0.01)
