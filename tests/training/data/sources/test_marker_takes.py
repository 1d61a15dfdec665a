"""Marker takes: a body's own markers lead back to its poses, gaps are gaps, and fits are kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.exchange.errors import FileDamaged
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.sposer import load_sposer
from training.data.sources import marker_takes
from training.data.sources.marker_takes import MarkerFit, fitted_takes, read_markers
from training.engine.accuracy import joint_distances

LABELS = marker_layout("PLUGIN_GAIT_39")
FRAMES = 6


@pytest.fixture(scope="module")
def recorded() -> tuple[np.ndarray, np.ndarray]:
    """Return rotations, and markers in metres of a body of average shape."""
    body = load_body()
    standing = np.zeros((21, 3))
    standing[15, 2], standing[16, 2] = -1.1, 1.1
    prior = load_sposer()
    codes = prior.encode(exp_so3(standing + 0.15 * np.random.default_rng(0).standard_normal((FRAMES, 21, 3))))
    local = prior.decode(codes)
    upright = exp_so3(np.array([np.pi / 2, 0.0, 0.0]))
    frames = PosedFrames(np.tile(upright, (FRAMES, 1, 1)), local, np.tile([0.3, -0.2, 1.0], (FRAMES, 1)))
    subject = Subject(body, marker_landmarks(body, LABELS), np.zeros(10), np.zeros((39, 3)))
    return frames.local, pose(subject, frames).points


def write(path: Path, markers: np.ndarray) -> None:
    repeated = np.repeat(np.round(markers * 1e4).astype(np.int16), 10, axis=0)
    np.savez(path, positions_01mm=repeated, labels=np.array(LABELS), fps=np.float32(100.0))


def test_markers_lead_back_to_the_pose(recorded: tuple, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    local, markers = recorded
    folder, cache = tmp_path / "takes", tmp_path / "cache"
    folder.mkdir()
    gappy = markers[:3].copy()
    gappy[1, 7] = 0.0
    write(folder / "m01_s01_e01.npz", gappy)
    write(folder / "m02_s01_e01_inc.npz", markers[3:])
    monkeypatch.setattr(marker_takes, "FIT", MarkerFit(robust_scale=5.0, sample=FRAMES))
    takes = fitted_takes(folder, cache)
    assert [(t.name, t.subject) for t in takes] == [("m01_s01_e01", "s01"), ("m02_s01_e01_inc", "s01")]
    residual = np.concatenate([t.residual_mm for t in takes])
    assert residual.shape == (FRAMES,) and residual.mean() < 7.0
    fitted = np.concatenate([t.rotations for t in takes]).astype(np.float64)
    assert 1000 * joint_distances(local, fitted).mean() < 20.0
    kept = fitted_takes(folder, cache)
    for first, again in zip(takes, kept, strict=True):
        np.testing.assert_array_equal(first.rotations, again.rotations)
        np.testing.assert_allclose(first.residual_mm, again.residual_mm)


def test_missing_markers_are_missing(recorded: tuple, tmp_path: Path) -> None:
    markers = recorded[1].copy()
    markers[2, 5] = 0.0
    write(tmp_path / "m.npz", markers)
    labels, read = read_markers(tmp_path / "m.npz")
    assert labels == LABELS and read.shape == markers.shape
    assert np.isnan(read[2, 5]).all() and np.isnan(read).sum() == 3
    np.testing.assert_allclose(np.nan_to_num(read), markers, atol=6e-5)
    (tmp_path / "m.npz").write_bytes(b"no archive")
    with pytest.raises(FileDamaged, match=r"marker take cannot be read.*m\.npz"):
        read_markers(tmp_path / "m.npz")
