"""Test that OpenSim's angles are read and compared."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks.bench_open_sim import compare
from tests.support.open_sim import flexion_deg, read_mot

HEADER = "Coordinates\nversion=1\nnRows=2\nnColumns=3\ninDegrees=yes\n\nendheader\n"


def test_columns_come_by_name(tmp_path: Path) -> None:
    path = tmp_path / "a.mot"
    path.write_text(HEADER + "time\tknee_angle_r\tknee_angle_l\n0.0\t10.5\t-2\n0.1\t11.5\t-3\n", encoding="utf-8")
    assert read_mot(path)["knee_angle_r"].tolist() == [10.5, 11.5]
    radians = HEADER.replace("yes", "no")
    path.write_text(radians + "time knee_angle_r pelvis_tx\n2.0 0.5 0.5\n", encoding="utf-8")
    found = {name: float(values[0]) for name, values in read_mot(path).items()}
    assert found == {"time": 2.0, "knee_angle_r": pytest.approx(np.degrees(0.5)), "pelvis_tx": 0.5}
    path.write_text(HEADER.replace("inDegrees=yes", "") + "time\n0\n", encoding="utf-8")
    with pytest.raises(ValueError, match="degrees"):
        read_mot(path)
    path.write_text(HEADER + "time a\n0\n", encoding="utf-8")
    with pytest.raises(ValueError, match="2 columns"):
        read_mot(path)


def test_a_straight_hinge_is_0_and_a_right_angle_90() -> None:
    above, hinge = np.array([[0.0, 0, 2], [0, 0, 2]]), np.array([[0.0, 0, 1], [0, 0, 1]])
    assert flexion_deg(above, hinge, np.array([[0.0, 0, 0], [0, 1, 1]])) == pytest.approx([0.0, 90.0])


def test_a_constant_offset_is_told_apart() -> None:
    time = np.linspace(0, 6, 100)
    truth = {f"{side} {angle}": 30 * np.sin(time) for side in ("left", "right") for angle in ("knee", "elbow")}
    shifted = {name: values + (5 if "knee" in name else 0) for name, values in truth.items()}
    shifted["left elbow"] = truth["left elbow"] + np.where(np.arange(100) % 2, 2.0, -2.0)
    found = compare(shifted, truth)
    assert found["knee"] == pytest.approx((5.0, 0.0), abs=1e-9)
    assert found["elbow"] == pytest.approx((0.0, np.sqrt(2.0)), abs=1e-9)
