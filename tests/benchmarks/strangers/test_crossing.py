"""Test that two people who pass each other keep their identities if their order in the lists changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.io.load import load_capture
from tests.benchmarks.strangers.faults import crossing
from tests.benchmarks.strangers.take import demo_take


def test_people_who_pass_each_other_are_not_exchanged(tmp_path: Path) -> None:
    take = demo_take()
    crossing(tmp_path / "trial", take)
    people = load_capture(tmp_path / "trial").people
    off = [np.linalg.norm(person.keypoints.xy - take.points[..., :2], axis=-1) for person in people]
    shares = sorted(float((np.nanmedian(o, axis=-1) < 5).mean()) for o in off)
    assert len(people) == 2 and shares[0] < 0.05 and shares[1] > 0.95
