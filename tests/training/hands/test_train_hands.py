"""The prior of hands comes out of its data by its command; sources are read as their description has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.hand_skeleton import ANGLES
from solver_backend.priors.hand_prior import PRIOR
from solver_backend.priors.weights import ASSETS, read_weights
from tests.support.recordings import ABSENT, recordings_folder
from training.hands.train import HELD, chi_square, load_sources, moments, ranges, squared_distances, train_hands

DATA = recordings_folder() / "hands"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=ABSENT)


@needs_data
def test_the_weights_that_ship_are_what_the_command_writes(tmp_path: Path) -> None:
    train_hands(DATA, tmp_path)
    shipped, made = (read_weights(folder / f"{PRIOR}.npz", PRIOR) for folder in (ASSETS, tmp_path))
    for name, value in shipped.arrays.items():
        np.testing.assert_allclose(made.arrays[name], value, atol=1e-9)
    assert (tmp_path / "hands.md").read_text().count("CC BY 4.0: Ganguly") == 1


@needs_data
def test_poses_are_read_as_their_names_say() -> None:
    godot = load_sources(DATA)[0]
    names = [str(name) for name in np.load(DATA / "godot_xr_hand_poses.npz")["poses"]]
    flexion = [i for i, name in enumerate(ANGLES) if name.endswith("pip_flexion")]
    bent = np.rad2deg(godot.angles[:, flexion])
    assert bent[names.index("Grip")].min() > 60
    assert np.abs(bent[names.index("Straight")]).max() < 20


@needs_data
def test_the_ellipsoid_holds_what_it_was_made_to_hold() -> None:
    prior, (low, high) = read_weights(ASSETS / f"{PRIOR}.npz", PRIOR).arrays, ranges()
    for source in load_sources(DATA):
        far = squared_distances(np.clip(source.angles, low, high), prior["mean"], prior["covariance"])
        assert (far < chi_square(HELD)).mean() > HELD - 0.001


def test_chi_square_is_that_of_the_tables() -> None:
    assert chi_square(0.95, 21) == pytest.approx(32.67, abs=0.05)
    assert chi_square(0.5, 21) == pytest.approx(20.34, abs=0.05)


def test_sources_count_alike_however_many_poses_they_have() -> None:
    rng = np.random.default_rng(0)
    few, many = rng.normal(0.5, 0.1, (10, len(ANGLES))), rng.normal(-0.5, 0.1, (1000, len(ANGLES)))
    mean, covariance = moments([few, many])
    np.testing.assert_allclose(mean, 0.5 * (few.mean(0) + many.mean(0)))
    assert np.diag(covariance).min() > 0.2
