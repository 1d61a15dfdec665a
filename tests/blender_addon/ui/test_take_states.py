"""Random sequences of what an animator does with takes: after each step the body stands where an oracle says.

The oracle computes joints in NumPy from the solved motion and from what the sequence has done. It reads nothing from
Blender.
"""

from __future__ import annotations

import random
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon.animation.action import pose_channels
from blender_addon.animation.curves import curve_target
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.key_reduction import posed_joints, rest_of
from blender_addon.animation.layers import has_layers
from blender_addon.animation.takes import SolvedAgain
from blender_addon.body.controls.limbs import LIMBS, ROOT
from blender_addon.conventions.skeleton import JOINTS
from blender_addon.ui.operators.import_results import take_motion
from solver_backend.exchange.motion_file import read_motion
from solver_backend.exchange.so3 import quat_multiply

FRAMES = (4, 12, 25)
EDITED = 12
"""The frame of hand edits, which is inside the range that is solved again."""
RANGE = (8, 16)
CHEST, PELVIS = "spine3", "pelvis"
STEPS = 30
ATOL_M = 1e-4


@dataclass
class Take:
    """A take as the oracle knows it."""

    edit: float = 0.0
    """Turn of the chest in the edited frame, in radians."""
    root: float = 0.0
    """Keyed place of the root control along X."""
    place: float = 0.0
    """Place of the object along Y."""
    ik: set[str] = field(default_factory=set)
    """Switches of limbs that are posed from their ends, which a turn of the trunk leaves where they are."""


@dataclass
class State:
    """What the sequence has made."""

    takes: dict[str, Take] = field(default_factory=dict)
    current: str = ""
    layers: list[dict[str, float]] = field(default_factory=list)
    """Chest turn, pelvis and root offset of each layer on top of the current take."""
    on_nla: bool = False
    """The current take plays from the NLA."""
    own: bool = False
    """An action of the user's replaces the take; it poses the chest alone."""
    users: set[str] = field(default_factory=set)
    """Names of actions that only the user has made."""


class Sequence:
    """One sequence, its oracle, and the undo history of both."""

    def __init__(self, seed: int, solved: Any, folder: Path) -> None:
        self.random, self.solved, self.path = random.Random(seed), solved, folder / "states.blend"
        self.state = State()
        self.log: list[str] = []
        motion, armature = read_motion(solved.files.motion), self.armature
        rest_pelvis = np.array(armature["rest_pelvis"])
        self.channels = pose_channels(motion, armature, rest_pelvis)[[frame - 1 for frame in FRAMES]]
        self.rest = rest_of(armature)
        self.chest = 3 + 4 * JOINTS.index(CHEST)
        take = bpy.context.scene.mocap.review.take
        self.state.takes[take.name], self.state.current = Take(), take.name
        bpy.ops.ed.undo_push(message="start")
        self.past, self.future = [deepcopy(self.state)], list[State]()
        self.saved: State | None = None

    @property
    def armature(self) -> bpy.types.Object:
        return bpy.context.scene.mocap.review.armature

    def expected(self) -> np.ndarray:
        """Return the joints on each frame, (F, J, 3) metres."""
        take, channels = self.state.takes[self.state.current], self.channels.copy()
        turn = slice(self.chest, self.chest + 4)
        if take.edit:
            row = FRAMES.index(EDITED)
            channels[row, turn] = quat_multiply(channels[row, turn], bowing(take.edit))
        moved = np.array([take.root, take.place, 0.0])
        for layer in self.state.layers:
            channels[:, turn] = quat_multiply(channels[:, turn], bowing(layer["chest"]))
            channels[:, 0] += layer["pelvis"]
            moved[0] += layer["root"]
        return posed_joints(channels, *self.rest)[1] + moved

    def compared(self) -> list[int]:
        """Return the joints that the oracle knows: under a layer that moves the trunk, none that IK places."""
        moves = any(layer["pelvis"] or layer["chest"] for layer in self.state.layers)
        limbs = [limb for limb in LIMBS if moves and limb.switch in self.state.takes[self.state.current].ik]
        placed = {joint for limb in limbs for joint in (*limb.joints[1:], limb.control.removesuffix("_ik"))}
        return [j for j, joint in enumerate(JOINTS) if joint not in placed]

    def check(self) -> None:
        """Compare the body with the oracle, and look for lost actions."""
        where = "\n".join([*self.log, repr(self.state)])
        review, state = bpy.context.scene.mocap.review, self.state
        for name in state.users:
            action = bpy.data.actions.get(name)
            assert action is not None and action.users > 0, f"{name} was lost\n{where}"
        assert {action.name for action in bpy.data.actions if "motion_file" in action} == set(state.takes), where
        if state.own:
            return
        assert review.take is not None and review.take.name == state.current, f"{review.take}\n{where}"
        assert has_layers(self.armature) == bool(state.layers), where
        found = np.stack([evaluated_joints(bpy.context.scene, self.armature, float(frame)) for frame in FRAMES])
        off = np.linalg.norm(found - self.expected(), axis=-1)[:, self.compared()]
        assert off.max() < ATOL_M, f"{1000 * off.max(axis=1)} mm off\n{where}"

    def run(self) -> None:
        """Take random steps."""
        self.check()
        for _ in range(STEPS):
            steps = [step for step in STEPS_OF if STEPS_OF[step](self)]
            step = self.random.choice(steps)
            self.log.append(step)
            if getattr(self, step)() is not False:
                bpy.ops.ed.undo_push(message=step)
                self.past.append(deepcopy(self.state))
                self.future.clear()
            self.check()

    # Steps: each changes Blender and the oracle. False: it is no step of the undo history.

    def solve(self) -> None:
        take = take_motion(bpy.context, self.solved.files)
        self.shown(take.name, Take(place=self.placed))

    @property
    def placed(self) -> float:
        return self.state.takes[self.state.current].place

    def shown(self, name: str, take: Take | None = None) -> None:
        """Note that a take plays: below the layers if there are any, else instead of what played."""
        state = self.state
        if take is not None:
            state.takes[name] = take
        state.current, state.on_nla, state.own = name, bool(state.layers), False

    def solve_range(self) -> None:
        former = self.state.current
        again = SolvedAgain(former, RANGE[0] - 1, RANGE[1] - 1)
        take = take_motion(bpy.context, self.solved.files, again=again)
        self.shown(take.name, replace(self.state.takes[former], edit=0.0))

    def click(self) -> None:
        name = self.random.choice(sorted(self.state.takes))
        assert bpy.ops.mocap.show_take(name=name) == {"FINISHED"}
        self.shown(name)

    def push_down(self) -> None:
        assert bpy.ops.mocap.push_down() == {"FINISHED"}
        self.state.on_nla = True

    def add_layer(self) -> None:
        assert bpy.ops.mocap.edit_on_layer() == {"FINISHED"}
        self.state.layers.append({"chest": 0.0, "pelvis": 0.0, "root": 0.0})
        self.state.users.add(self.armature.animation_data.action.name)
        self.state.on_nla = True
        self.layer_key()

    def key(self, bone: str, prop: str, values: Any, frame: int = 1) -> None:
        """Key a property in the body's own action as it is, where Blender's operator would undo what plays below."""
        animation = self.armature.animation_data
        target = curve_target(animation.action, getattr(animation, "action_slot", None))
        assert target is not None
        path, curves = f'pose.bones["{bone}"].{prop}', target.container.fcurves
        for index, value in enumerate(values):
            curve = curves.find(path, index=index) or curves.new(path, index=index)
            curve.keyframe_points.insert(frame, value)
            curve.update()

    def layer_key(self) -> None:
        # Blender's COMBINE takes the angle from a cosine in single precision: turns below 5e-4 rad are lost.
        chest, pelvis = self.random.choice((-1, 1)) * self.random.uniform(0.05, 0.5), self.random.uniform(-0.2, 0.2)
        self.key(CHEST, "rotation_quaternion", bowing(chest))
        self.key(PELVIS, "location", (pelvis, 0.0, 0.0))
        self.state.layers[-1] |= {"chest": chest, "pelvis": pelvis}

    def root_key(self) -> None:
        x = self.random.uniform(-0.5, 0.5)
        self.key(ROOT, "location", (x, 0.0, 0.0))
        if self.state.layers:
            self.state.layers[-1]["root"] = x
        else:
            self.state.takes[self.state.current].root = x

    def place(self) -> None:
        y = self.random.uniform(-0.5, 0.5)
        self.armature.location.y = y
        self.state.takes[self.state.current].place = y

    def edit(self) -> None:
        angle = self.random.uniform(0.1, 0.5)
        turn = quat_multiply(self.channels[FRAMES.index(EDITED), self.chest : self.chest + 4], bowing(angle))
        self.key(CHEST, "rotation_quaternion", turn, EDITED)
        self.state.takes[self.state.current].edit = angle

    def switch_limbs(self) -> None:
        to, limb = self.random.choice(["IK", "FK"]), self.random.choice(["ALL", "left_arm_ik", "right_leg_ik"])
        assert bpy.ops.mocap.switch_limbs(to=to, limb=limb) == {"FINISHED"}
        switches = {item.switch for item in LIMBS} if limb == "ALL" else {limb}
        take = self.state.takes[self.state.current]
        take.ik = take.ik | switches if to == "IK" else take.ik - switches

    def own_action(self) -> None:
        animation: Any = self.armature.animation_data
        animation.action = None
        self.armature.pose.bones[CHEST].keyframe_insert("rotation_quaternion", frame=1)
        action = animation.action
        assert action is not None
        self.state.users.add(action.name)
        self.state.own = True

    def duplicate(self) -> None:
        name = self.state.current
        assert bpy.ops.mocap.show_take(name=name) == {"FINISHED"}  # which stores the place that the copy keeps
        copy = bpy.data.actions[name].copy()
        copy.use_fake_user = True
        self.state.takes[copy.name] = deepcopy(self.state.takes[name])

    def rename(self) -> None:
        state = self.state
        name = self.random.choice(sorted(state.takes))
        action = bpy.data.actions[name]
        action.name = f"Renamed {self.random.randrange(1000)}"
        state.takes[action.name] = state.takes.pop(name)
        state.current = action.name if state.current == name else state.current

    def delete(self) -> None:
        state = self.state
        name = self.random.choice(sorted(state.takes))
        assert bpy.ops.mocap.delete_take(name=name) == {"FINISHED"}
        del state.takes[name]
        if name == state.current:
            self.shown(bpy.context.scene.mocap.review.take.name)

    def undo(self) -> bool:
        bpy.ops.ed.undo()
        self.future.append(self.past.pop())
        self.state = deepcopy(self.past[-1])
        return False

    def redo(self) -> bool:
        bpy.ops.ed.redo()
        self.past.append(self.future.pop())
        self.state = deepcopy(self.past[-1])
        return False

    def save(self) -> bool:
        bpy.ops.wm.save_as_mainfile(filepath=str(self.path))
        self.saved = deepcopy(self.state)
        return False

    def reload(self) -> bool:
        bpy.ops.wm.open_mainfile(filepath=str(self.path))
        assert self.saved is not None
        self.state = deepcopy(self.saved)
        bpy.ops.ed.undo_push(message="reload")
        self.past, self.future = [deepcopy(self.state)], []
        return False


def bowing(angle: float) -> np.ndarray:
    return np.array([np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0])


def plain(sequence: Sequence) -> bool:
    """Return whether the current take is the body's own action."""
    state = sequence.state
    return not (state.own or state.layers or state.on_nla)


STEPS_OF = {
    "solve": lambda s: len(s.state.takes) < 6,
    "solve_range": lambda s: not s.state.own and len(s.state.takes) < 6,
    "click": lambda s: True,
    "push_down": plain,
    "add_layer": lambda s: not s.state.own and len(s.state.layers) < 3,
    "layer_key": lambda s: bool(s.state.layers),
    "root_key": lambda s: plain(s) or bool(s.state.layers),
    "place": lambda s: not s.state.own,
    "edit": lambda s: plain(s) and not s.state.takes[s.state.current].ik,
    "switch_limbs": plain,
    "own_action": plain,
    "duplicate": lambda s: (plain(s) or bool(s.state.layers)) and len(s.state.takes) < 6,
    "rename": lambda s: True,
    "delete": lambda s: len(s.state.takes) > 1 and not s.state.own,
    "undo": lambda s: len(s.past) > 1,
    "redo": lambda s: bool(s.future),
    "save": lambda s: True,
    "reload": lambda s: s.saved is not None,
}
"""When each step can be taken."""


def run(seed: int, solved: Any, folder: Path) -> None:
    bpy.context.preferences.edit.use_global_undo = True
    Sequence(seed, solved, folder).run()


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_takes_never_corrupt_each_other(mocap, solved_take, solved, tmp_path: Path, seed: int) -> None:
    run(seed, solved, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 202))
def test_many_sequences_corrupt_no_take(mocap, solved_take, solved, tmp_path: Path, seed: int) -> None:
    run(seed, solved, tmp_path)
