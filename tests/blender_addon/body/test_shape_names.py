"""Sliders are named by what they were measured to do, whatever the order and sign of a body's directions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from blender_addon.body.body_file import BodyFile
from blender_addon.body.rig import Rig
from blender_addon.body.shape import effect_of, shape_names, sliders
from blender_addon.conventions.skeleton import JOINTS
from tests.support.posed_rig import evaluated


def test_the_bodys_own_directions(body: BodyFile) -> None:
    names = shape_names(body)
    assert names[:3] == ("stature", "build", "leg length") and len(set(names)) == 10


def test_order_and_sign_do_not_matter(body: BodyFile) -> None:
    names = shape_names(body)
    order = np.random.default_rng(4).permutation(10)
    assert shape_names(replace(body, shapedirs=body.shapedirs[:, :, order])) == tuple(names[k] for k in order)
    turned = shape_names(replace(body, shapedirs=-body.shapedirs))
    assert turned[:3] == ("short stature", "slenderness", "trunk length")


def test_directions_that_do_nothing_are_details(body: BodyFile) -> None:
    assert set(shape_names(replace(body, shapedirs=np.zeros_like(body.shapedirs)))) == {"detail"}


def test_a_slider_does_what_it_says(rig: Rig) -> None:
    keys = {effect_of(key): key for key in sliders(rig.mesh)}
    joints, vertices = evaluated(rig)

    def leg_share(joints: np.ndarray, vertices: np.ndarray) -> float:
        hip, ankle = joints[JOINTS.index("left_hip")], joints[JOINTS.index("left_ankle")]
        return float(np.linalg.norm(hip - ankle) / np.ptp(vertices[:, 2]))

    keys["Leg length"].value = 2.0
    assert leg_share(*evaluated(rig)) > 1.03 * leg_share(joints, vertices)
    keys["Leg length"].value, keys["Stature"].value = 0.0, 1.0
    assert np.ptp(evaluated(rig)[1][:, 2]) > 1.04 * np.ptp(vertices[:, 2])
