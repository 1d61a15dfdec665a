"""Which way limbs point: chances of three classes for eight bones, and what they say of a solved pose."""

from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.exchange.joint_sets import SMPL_JOINTS
from solver_backend.priors.view_lifter import (
    BONES,
    PARTS,
    bone_slants,
    flip_chances,
    load_limb_slants,
    load_view_lifter,
    slant_classes,
)
from solver_backend.priors.view_lifter import SLANT_WEIGHTS as DEFAULT_WEIGHTS
from solver_backend.priors.weights import read_weights, write_weights
from tests.support.limb_errors import BONES as LIMBS


def test_bones_are_those_of_the_limbs_in_their_order() -> None:
    assert [SMPL_JOINTS[last] for _, last in BONES[1::2]] == ["left_wrist", "left_ankle", "right_wrist", "right_ankle"]
    assert [(a, b, c) for (a, b), (_, c) in zip(BONES[::2], BONES[1::2], strict=True)] == list(LIMBS)
    assert len(PARTS) == 4


def test_a_slant_is_the_sine_of_the_angle_to_the_picture() -> None:
    joints = np.zeros((1, 24, 3))
    first, last = BONES[1]
    joints[0, last] = joints[0, first] + 0.3 * np.array([np.cos(0.5), 0.0, np.sin(0.5)])
    slants = bone_slants(joints, np.array([[0.0, 0.0, 1.0]]))
    assert slants[0, 1] == pytest.approx(np.sin(0.5))
    assert slant_classes(np.array([-0.5, 0.1, 0.5])).tolist() == [0, 1, 2]


def test_the_chance_of_a_flip_is_that_of_the_other_way_of_either_bone() -> None:
    chances, slants = np.zeros((1, 8, 3)), np.zeros((1, 8))
    chances[0] = [0.2, 0.5, 0.3]
    slants[0, :4] = [0.9, 0.0, -0.9, -0.9]
    np.testing.assert_allclose(flip_chances(chances, slants), [[0.2, 1.0 - 0.7 * 0.7, 0.0, 0.0]])


def test_chances_add_up_to_one_and_the_file_is_small() -> None:
    hidden = np.random.default_rng(0).normal(size=(5, load_view_lifter().width))
    chances = load_limb_slants()(hidden)
    assert chances.shape == (5, 8, 3) and (chances > 0).all()
    np.testing.assert_allclose(chances.sum(axis=-1), 1.0)
    assert DEFAULT_WEIGHTS.stat().st_size < 60_000


def test_weights_of_another_view_lifter_are_refused(tmp_path: Path) -> None:
    weights = read_weights(DEFAULT_WEIGHTS, "limb_slants")
    other = {"network_hidden": [64], "activation": "silu", "view_lifter_sha256": "another"}
    write_weights(tmp_path / "w.npz", type(weights)("limb_slants", weights.arrays, other))
    with pytest.raises(WeightsInvalid, match="another view lifter"):
        load_limb_slants(tmp_path / "w.npz")
