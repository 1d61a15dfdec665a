"""Histograms of a shot count every frame once, and tell a bent knee from a straight one."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.studio.sensor_pictures import poses_of, views_of
from solver_backend.synthesis.studio.spec import spec_of
from solver_backend.synthesis.studio.stage import list_shots, set_up
from solver_backend.types import SMPL_JOINTS, JointSet


def posed(**turns: tuple[float, float, float]) -> np.ndarray:
    """Return (1, 24, 3) joints of somebody upright whose joints are turned."""
    local = np.zeros((1, 21, 3))
    for joint, turn in turns.items():
        local[0, SMPL_JOINTS.index(joint) - 1] = turn
    upright = exp_so3(np.array([[np.pi / 2, 0, 0]]))
    person = Person(load_body(), np.zeros(10), upright, exp_so3(local), np.zeros((1, 3)))
    return person.landmarks(JointSet.SMPL_24).points


def test_angles_fall_into_their_sectors() -> None:
    standing = poses_of(posed())
    assert standing["knee bent"] == [2, 0, 0, 0, 0, 0] == standing["thigh before trunk"]
    assert standing["trunk off upright"] == [1, 0, 0, 0, 0, 0]
    assert standing["arm off trunk"][2:4] in ([2, 0], [0, 2], [1, 1]), "the T-pose's arms stand level"
    bent = poses_of(posed(left_knee=(1.7, 0, 0), right_hip=(-1.3, 0, 0)))
    assert bent["knee bent"][0] == 1 == bent["knee bent"][3]
    assert bent["thigh before trunk"][0] == 1 == bent["thigh before trunk"][2]


def test_every_frame_and_view_is_counted_once() -> None:
    spec = spec_of({"frames": 20, "fps": 4, "camera_arrays": [{"count": 5}]})
    stage = set_up(spec, list_shots(spec)[0])
    assert sum(views_of(stage)) == 5 * stage.num_frames
    for name, counts in poses_of(stage.joints).items():
        assert sum(counts) == stage.num_frames * (1 if name.startswith("trunk") else 2), name
