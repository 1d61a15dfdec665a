"""Motions of foreign skeletons onto our body: known truth, real clips, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solver_backend.body.body import Body, load_body
from solver_backend.body.hand_skeleton import ANGLES
from solver_backend.body.hands import finger_rotations, with_fingers
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.cli.main import main
from solver_backend.cli.motion_reading import _found_in, read_foreign_motion
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.errors import FileDamaged, MotionInvalid, NonFiniteData
from solver_backend.exchange.progress import silent
from solver_backend.fitters.hands.solve_hand import FINGERS as FINGER_STATES
from solver_backend.fitters.hands.solve_hands import finger_turns_of
from solver_backend.fitters.motion_import.import_motion import ImportedMotion, floor_height, import_motion
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.io.motions.foreign_skeleton import read_foreign_clip
from solver_backend.io.native.motion_file import read_motion
from solver_backend.synthesis.embedded.demo import author_motion
from tests.support.bvh_texts import Y_UP, KnownMotion, known_motion, with_proportions, write_bvh
from tests.support.moving_hand import drawn_states
from tests.support.words import codes

BETAS = np.array([0.8, -0.5, 0.6, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
LIMB_JOINTS = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
LIMBS = [1, 2, 4, 5, 7, 8, 16, 17, 18, 19, 20, 21]


@pytest.fixture(scope="module")
def body() -> Body:
    return load_body()


@pytest.fixture(scope="module")
def known(body: Body) -> KnownMotion:
    return known_motion(body, BETAS)


def bring(path: Path, body: Body, *, keep_height: bool = True) -> ImportedMotion:
    source, roles, _ = read_foreign_clip(path)
    return import_motion(source, roles, body, keep_height=keep_height)


def rotations(done: ImportedMotion) -> np.ndarray:
    return exp_so3(done.motion.body_pose.reshape(done.motion.num_frames, -1, 3))


@pytest.mark.parametrize("order", ["XYZ", "ZXY", "YXZ", "ZYX"])
@pytest.mark.parametrize(("unit", "arms_down"), [(0.01, 0.0), (1.0, 0.8), (0.0254, 1.3)])
def test_a_known_motion_comes_back(tmp_path: Path, body: Body, known: KnownMotion, order, unit, arms_down) -> None:
    path = write_bvh(tmp_path / "clip.bvh", known, order=order, unit=unit, arms_down=arms_down)
    done = bring(path, body)
    off = np.linalg.norm(done.motion.joints - known.posed.joints, axis=-1)[:, LIMBS]
    assert off.max() < 0.01 and np.sqrt((off**2).mean()) < 0.004
    own = rotations(done)
    step = log_so3(own[:-1].swapaxes(-1, -2) @ own[1:])
    assert np.degrees(np.linalg.norm(step, axis=-1)).max() < 60.0


def test_arms_that_end_at_the_elbow_and_hang_at_rest_point_where_the_skeletons_do(tmp_path: Path, body: Body) -> None:
    """Names alone show a person whose arms have no hands; forearms are taken to be straight at rest."""
    whole, elbows = known_motion(body, BETAS, 30), 20
    few = replace(whole, parents=whole.parents[:elbows], names=whole.names[:elbows], rest=whole.rest[:elbows])
    sides = {"hip": "UpLeg", "knee": "Leg", "ankle": "Foot", "foot": "Toe", "collar": "Shoulder", "shoulder": "Arm"}
    usual = {
        f"{s}_{own}": s.title() + name for s in ("left", "right") for own, name in {**sides, "elbow": "ForeArm"}.items()
    }
    names = tuple(usual.get(name, {"pelvis": "Hips"}.get(name, name)) for name in few.names)
    done = bring(write_bvh(tmp_path / "clip.bvh", few, arms_down=0.9, names=names), body)
    for elbow, wrist in ((18, 20), (19, 21)):
        ours, theirs = (points[:, wrist] - points[:, elbow] for points in (done.motion.joints, whole.posed.joints[:30]))
        cosine = (ours * theirs).sum(-1) / np.linalg.norm(ours, axis=-1) / np.linalg.norm(theirs, axis=-1)
        assert np.degrees(np.arccos(cosine.min())) < 8.0


def test_joints_without_names_and_files_with_z_up_are_read(tmp_path: Path, body: Body, known: KnownMotion) -> None:
    names = tuple(f"joint_{(7 * j) % 24}" for j in range(24))
    path = write_bvh(tmp_path / "clip.bvh", known, names=names, turn=np.eye(3), unit=0.001, order="XYZ")
    source, roles, notes = read_foreign_clip(path)
    done = import_motion(source, roles, body, keep_height=True)
    off = np.linalg.norm(done.motion.joints - known.posed.joints, axis=-1)[:, LIMBS]
    assert off.max() < 0.01 and codes(notes) == ("unit_read", "up_axis_read")
    assert notes[0].values["unit"] == "mm" and notes[1].values["axis"] == "Z"


def _named(naming: str) -> tuple[str, ...]:
    """Return the names of a dialect for the body's joints: a pattern, or its words for sides and parts."""
    if "{" in naming:
        return tuple(naming.format(name) for name in SMPL.joints)
    left, right, *parts = naming.split()
    words = dict(part.split("=") for part in parts)
    names = []
    for joint in SMPL.joints:
        side, _, part = joint.partition("_")
        name = {"left": left, "right": right}[side] + words.get(part, part.title()) if part else words.get(side, side)
        names.append(name)
    return tuple(names)


_LEGS = "hip=UpLeg knee=Leg ankle=Foot foot=ToeBase collar=Shoulder shoulder=Arm elbow=ForeArm wrist=Hand hand=HandEnd"
_TRUNK = "pelvis=Hips spine1=Spine spine2=Spine1 spine3=Spine2 neck=Neck head=Head"
_SUITS = (
    "hip=Hip knee=Knee ankle=Ankle foot=Toe collar=Collar shoulder=Shoulder elbow=Elbow wrist=Wrist hand=Palm "
    "pelvis=Hips spine1=Chest spine2=Chest2 spine3=Chest3 neck=Neck head=Head"
)
_SAM = "hip=upleg knee=lowleg ankle=foot foot=ball collar=clavicle shoulder=uparm elbow=lowarm wrist=wrist hand=hand"
DIALECTS: dict[str, tuple[str, dict[str, Any]]] = {
    "Bandai-Namco": (f"_L _R {_LEGS} {_TRUNK}", {"places": "offset", "still_root": True, "order": "ZYX"}),
    "LAFAN1": (f"Left Right {_LEGS} {_TRUNK}", {"order": "ZYX", "arms_down": 1.2}),
    "100STYLE": (f"Left Right {_SUITS}", {"places": "offset", "order": "YXZ"}),
    "Mixamo": (f"mixamorig:Left mixamorig:Right {_LEGS} {_TRUNK}", {"order": "ZXY"}),
    "Rokoko": (f"Left Right {_LEGS} {_TRUNK}", {"places": "offset", "order": "YXZ"}),
    "Xsens": (f"Left Right {_SUITS}", {"order": "YXZ"}),
    "MotionBuilder": (f"Character:Left Character:Right {_LEGS} {_TRUNK}", {"places": "offset", "order": "XYZ"}),
    "HumanIK": (f"Character1_Left Character1_Right {_LEGS} {_TRUNK}", {"places": "offset", "order": "XYZ"}),
    "cgspeed": (f"l r {_LEGS} {_TRUNK}", {"unit": 0.0564444, "order": "ZYX"}),
    "MakeHuman": (f"Left Right {_SUITS}", {"places": "shift", "unit": 0.1, "turn": np.eye(3), "order": "XZY"}),
    "SAM3DBody-cpp": (f"l_ r_ {_SAM} pelvis=root spine1=spine0", {"unit": 1.0, "order": "XYZ", "places": "offset"}),
    "MocapNET": (f"l r {_SUITS}", {"unit": 0.0254, "order": "ZXY"}),
    "Perception Neuron": (f"Left Right {_LEGS} {_TRUNK}", {"places": "offset", "order": "YXZ", "arms_down": 0.4}),
}
"""Dialects of other programs by their descriptions: names, order of channels, units, axes and position channels."""


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_dialect_is_read_as_its_program_shows_it(tmp_path: Path, known: KnownMotion, dialect: str) -> None:
    naming, how = DIALECTS[dialect]
    path = write_bvh(tmp_path / "clip.bvh", known, names=_named(naming), **how)
    source, roles, _ = read_foreign_clip(path)
    for side in ("left", "right"):
        for role, joint in zip(("thigh", "shin", "foot", "upper_arm", "forearm", "hand"), LIMB_JOINTS, strict=True):
            number = SMPL.joints.index(f"{side}_{joint}")
            off = source.joints[:, source.names.index(roles[f"{side}_{role}"])] - known.posed.joints[:, number]
            assert np.abs(off).max() < 0.001


@pytest.mark.parametrize("seed", [0, 12])
@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_dialect_of_a_skeleton_with_other_proportions_is_within_12_mm(
    tmp_path: Path, body: Body, known: KnownMotion, dialect: str, seed: int
) -> None:
    naming, how = DIALECTS[dialect]
    other = with_proportions(known, seed)
    done = bring(write_bvh(tmp_path / "clip.bvh", other, names=_named(naming), **how), body)
    assert np.linalg.norm(done.motion.joints - other.posed.joints, axis=-1)[:, LIMBS].max() < 0.012


def test_positions_for_offsets_of_a_travelling_joint_below_a_still_root(
    tmp_path: Path, body: Body, known: KnownMotion
) -> None:
    naming, how = DIALECTS["Bandai-Namco"]
    done = bring(write_bvh(tmp_path / "clip.bvh", known, names=_named(naming), **how), body)
    assert np.linalg.norm(done.motion.joints - known.posed.joints, axis=-1)[:, LIMBS].max() < 0.012


@pytest.mark.parametrize(("turn", "axis"), [(Y_UP, 1), (np.eye(3), 2)])
def test_a_lying_person_keeps_the_up_axis_of_the_rest_skeleton(tmp_path: Path, known: KnownMotion, turn, axis) -> None:
    """The person lies along the other axis, far from the origin; the bones at rest stand."""
    prone = exp_so3(np.array([1.45, 0.05, 0.0]))
    joints = known.posed.joints @ prone.T + [0.0, 3.0, 0.2]
    rest = known.rest if axis == 1 else known.rest @ Y_UP
    G = prone @ known.posed.G if axis == 1 else prone @ known.posed.G @ Y_UP
    lying = replace(known, rest=rest, posed=replace(known.posed, joints=joints, G=G))
    source, roles, notes = read_foreign_clip(write_bvh(tmp_path / "clip.bvh", lying, turn=turn))
    off = source.joints[:, source.names.index(roles["head"])] - joints[:, 15]
    assert np.abs(off).max() < 0.001
    assert [n.values["source"] for n in notes if n.code == "up_axis_read"] == ["rest"]


@pytest.mark.parametrize(
    ("rest_up", "shift"),
    [
        pytest.param("z", (0.0, 0.0, 0.0), id="rest Z up, motion Y up"),
        pytest.param("z", (0.0, 0.0, -0.95), id="rest Z up, motion Y up, heights from the hips"),
        pytest.param("y", (0.0, 0.0, -0.95), id="rest Y up, motion Z up, heights from the hips"),
        pytest.param("y", (0.0, 0.0, 0.3), id="rest Y up, motion Z up, a floor at 0.3 m"),
    ],
)
def test_a_standing_person_keeps_the_up_axis_of_the_motion(
    tmp_path: Path, known: KnownMotion, rest_up: str, shift: tuple[float, float, float]
) -> None:
    middle = known.posed.joints[:, 0].mean(axis=0) * [1.0, 1.0, 0.0]
    joints = known.posed.joints - middle + shift
    rest, G, turn = known.rest, known.posed.G, np.eye(3)
    if rest_up == "z":
        rest, G, turn = rest @ Y_UP, G @ Y_UP, Y_UP
    standing = replace(known, rest=rest, posed=replace(known.posed, joints=joints, G=G))
    path = write_bvh(tmp_path / "clip.bvh", standing, turn=turn, order="XYZ")
    source, roles, _ = read_foreign_clip(path)
    assert np.abs(source.joints[:, source.names.index(roles["head"])] - joints[:, 15]).max() < 0.001


def test_frames_that_leap_away_and_back_are_interpolated_and_reported(tmp_path: Path, known: KnownMotion) -> None:
    """Recorders write a place far away where they saw nobody."""
    joints = known.posed.joints.copy()
    joints[40:43, :, 2] += 50.0
    path = write_bvh(tmp_path / "clip.bvh", replace(known, posed=replace(known.posed, joints=joints)))
    source, roles, notes = read_foreign_clip(path)
    off = source.joints[:, source.names.index(roles["pelvis"])] - known.posed.joints[:, 0]
    assert np.abs(off).max() < 0.03 and np.abs(np.delete(off, [40, 41, 42], axis=0)).max() < 1e-4
    [leap] = [note for note in notes if note.code == "motion_too_fast"]
    assert leap.where.frames == ((40, 42),) and leap.values["done"] == "interpolated"


def test_a_cut_in_a_clip_is_kept_and_reported(tmp_path: Path, known: KnownMotion) -> None:
    joints = known.posed.joints.copy()
    joints[45:] += [5.0, 0.0, 0.0]
    path = write_bvh(tmp_path / "clip.bvh", replace(known, posed=replace(known.posed, joints=joints)))
    source, roles, notes = read_foreign_clip(path)
    assert np.abs(source.joints[:, source.names.index(roles["pelvis"])] - joints[:, 0]).max() < 1e-4
    [leap] = [note for note in notes if note.code == "motion_too_fast"]
    assert leap.where.frames == ((44, 45),) and leap.values["done"] == "kept"


def test_a_torn_line_is_named(tmp_path: Path, known: KnownMotion) -> None:
    path = write_bvh(tmp_path / "clip.bvh", known)
    lines = path.read_text().splitlines()
    lines[-30] = " ".join(lines[-30].split()[:20])
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(FileDamaged, match=f"line {len(lines) - 29}, which has 20 words instead of 75 numbers"):
        read_foreign_clip(path)


def test_deviations_show_where_the_body_cannot_follow(tmp_path: Path, body: Body, known: KnownMotion) -> None:
    """A joint that the skeleton has elsewhere deviates by its share of that, too; of a skeleton like ours none does."""
    source, roles, _ = read_foreign_clip(write_bvh(tmp_path / "clip.bvh", known))
    near = import_motion(source, roles, body).motion
    joints = source.joints.copy()
    elbow = source.names.index(roles["left_forearm"])
    joints[:, elbow] += [0.06, 0.0, 0.0]
    far = import_motion(replace(source, joints=joints), roles, body, keep_height=True).motion
    assert near.joint_sigma is not None and far.joint_sigma is not None and near.resting is None
    assert 0.001 < near.joint_sigma[:, LIMBS].mean() < 0.006
    off = np.linalg.norm(far.joints[:, 18] - joints[:, elbow], axis=-1)
    assert off.min() > 0.005 and (far.joint_sigma[:, 18] > off / np.sqrt(3.0)).all()
    assert far.joint_sigma[:, 18].mean() > 2.0 * near.joint_sigma[:, 18].max()
    assert np.abs(far.joint_sigma[:, [4, 5, 7, 8]] - near.joint_sigma[:, [4, 5, 7, 8]]).max() < 0.003


def test_limbs_twist_as_the_skeletons_do(tmp_path: Path, body: Body, known: KnownMotion) -> None:
    done = bring(write_bvh(tmp_path / "clip.bvh", known), body)
    G = exp_so3(done.motion.global_orient)
    turned = log_so3(G.swapaxes(-1, -2) @ known.posed.G[:, 0])
    assert np.degrees(np.linalg.norm(turned, axis=-1)).max() < 10.0
    own = rotations(done)[:, [j - 1 for j in LIMBS]]
    true = known.posed.G[:, list(known.parents)[1:]].swapaxes(-1, -2) @ known.posed.G[:, 1:]
    off = np.linalg.norm(log_so3(own.swapaxes(-1, -2) @ true[:, [j - 1 for j in LIMBS]]), axis=-1)
    assert np.degrees(np.sqrt((off**2).mean())) < 8.0


def test_a_clip_about_its_hips_stands_on_the_floor(tmp_path: Path, body: Body, known: KnownMotion) -> None:
    sunk = replace(known, posed=replace(known.posed, joints=known.posed.joints - [0.0, 0.0, 0.95]))
    done = bring(write_bvh(tmp_path / "clip.bvh", sunk), body, keep_height=False)
    assert done.raised_m == pytest.approx(0.95, abs=0.03)
    assert done.motion.contacts is not None and done.motion.contacts.any(axis=1).mean() > 0.5


@pytest.mark.slow
def test_real_clips_are_near_and_do_not_flip(shared_data: Path, body: Body) -> None:
    poses = shared_data / "poses_makehuman_cc0/makehuman_data_bvhs_10_01.bvh"
    clips = [*sorted((shared_data / "bvh_samples").glob("*daz*.bvh")), poses]
    for path in clips:
        done = bring(path, body)
        placed = [off for role, off in done.distances_mm.items() if not role.endswith(("toe", "head"))]
        assert np.sqrt(np.mean(np.square(placed))) < 10.0, path.name


def test_the_verb_writes_a_motion(tmp_path: Path, known: KnownMotion, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = write_bvh(tmp_path / "clip.bvh", known), tmp_path / "motion.npz"
    assert main(["motion convert", str(path), "--out", str(out)]) == 0
    assert "Lengths are in cm, estimated from the leg length (0.87 m)" in capsys.readouterr().out
    assert read_motion(out).num_frames == 90
    assert main(["motion convert", str(path), "--out", str(out)]) == 3
    assert main(["motion convert", str(tmp_path / "clip.fbx"), "--out", str(tmp_path / "b.npz")]) == 3
    assert "read through Blender" in capsys.readouterr().err


def edited(path: Path, before: str, after: str) -> Path:
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after, 1))
    return path


def test_what_is_wrong_is_named(tmp_path: Path, known: KnownMotion) -> None:
    def clip(name: str, **how: object) -> Path:
        return write_bvh(tmp_path / f"{name}.bvh", known, **how)  # pyright: ignore[reportArgumentType]

    with pytest.raises(MotionInvalid, match="in any known unit"):
        read_foreign_clip(clip("huge", unit=1e-6))
    with pytest.raises(FileDamaged, match="0 frames"):
        read_foreign_clip(edited(clip("none"), "Frames: 90", "Frames: 0"))
    broken = clip("nan")
    last = broken.read_text().splitlines()[-1].split()
    with pytest.raises(NonFiniteData, match="NaN"):
        read_foreign_clip(edited(broken, " ".join(last), " ".join(["nan", *last[1:]])))
    with pytest.raises(MotionInvalid, match=r"Several joints are called 'joint'"):
        read_foreign_clip(clip("twice", names=("joint",) * 24))


def test_a_skeleton_without_legs_is_named(tmp_path: Path) -> None:
    lines = ["HIERARCHY", "ROOT Hips", "{", "OFFSET 0 0 0", "CHANNELS 3 Zrotation Xrotation Yrotation"]
    for name in ("Spine", "Neck", "Head"):
        lines += [f"JOINT {name}", "{", "OFFSET 0 20 0", "CHANNELS 3 Zrotation Xrotation Yrotation"]
    lines += ["End Site", "{", "OFFSET 0 10 0", "}", "}", "}", "}", "}", "MOTION", "Frames: 1", "Frame Time: 0.03"]
    path = tmp_path / "torso.bvh"
    path.write_text("\n".join([*lines, " ".join(["0"] * 12)]))
    with pytest.raises(MotionInvalid, match=r"No joints were found for left_thigh"):
        read_foreign_clip(path)


def test_limbs_that_are_missing_are_a_warning(tmp_path: Path, known: KnownMotion, capsys) -> None:
    """Without names, the wrist may be either of two joints of the arm: it plays without arms, and reports that."""
    rest = known.rest.copy()
    for shoulder, elbow, wrist, hand in ((16, 18, 20, 22), (17, 19, 21, 23)):
        upper = rest[elbow] - rest[shoulder]
        rest[wrist], rest[hand] = rest[elbow] + 0.75 * upper, rest[elbow] + 1.1 * upper
    names, out = tuple(f"joint_{(7 * j) % 24}" for j in range(24)), tmp_path / "motion.npz"
    path = write_bvh(tmp_path / "unclear.bvh", replace(known, rest=rest), names=names)
    assert main(["motion convert", str(path), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert "left_upper_arm" not in result["roles"]
    lacking = next(item for item in result["diagnostics"] if item["code"] == "motion_limbs_missing")
    assert lacking["severity"] == "warning" and lacking["values"]["parts"] == ["left arm", "right arm"]
    resting = read_motion(out).resting
    assert resting is not None and resting[:, [18, 19, 20, 21, 22, 23]].all() and not resting[:, :18].any()
    assert [note for note in result["notes"] if "ambiguous" in note] == ["The bones of the arms are ambiguous."]
    assert any("No joints were found for" in problem for problem in result["problems"])
    assert (
        main(
            [
                "motion convert",
                str(write_bvh(tmp_path / "whole.bvh", known)),
                "--out",
                str(tmp_path / "b.npz"),
                "--json",
            ]
        )
        == 0
    )
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["problems"] == []


def test_a_t_pose_before_the_clip_is_a_warning(tmp_path: Path, known: KnownMotion) -> None:
    """Its step into the motion would be smoothed, keyed and retargeted as if somebody moved so."""
    G = known.posed.G.copy()
    G[0] = Y_UP.T
    path = write_bvh(tmp_path / "t.bvh", replace(known, posed=replace(known.posed, G=G)))
    [apart] = [item for item in read_foreign_clip(path)[2] if item.code == "motion_first_frame_apart"]
    assert apart.where.frames == ((0, 0),) and apart.values["angle"] > 30.0
    whole = read_foreign_clip(write_bvh(tmp_path / "whole.bvh", known))[2]
    assert "motion_first_frame_apart" not in codes(whole)


def test_axes_of_the_file_can_be_given(tmp_path: Path, body: Body, known: KnownMotion) -> None:
    path = write_bvh(tmp_path / "clip.bvh", known, turn=Y_UP)
    given, roles, _ = read_foreign_clip(path, unit="cm", up_axis="y")
    assert np.abs(given.joints[:, given.names.index(roles["pelvis"])] - known.posed.joints[:, 0]).max() < 1e-4


def with_own_fingers(body: Body, betas: np.ndarray, frames: int = 60) -> tuple[KnownMotion, np.ndarray]:
    """Return the choreography with fingers that move, and the fingers' rotations (F, 30, 3, 3)."""
    played, fingered = author_motion(body, betas, frames, 30.0), with_fingers(body)
    angles = np.stack([drawn_states(frames, side)[:, FINGER_STATES] for side in range(2)], axis=1)
    angles[..., ANGLES.index("thumb_cmc_twist")] = 0.0
    fingers = finger_rotations(fingered, angles)
    local = np.concatenate([exp_so3(played.body_pose.reshape(frames, -1, 3))[:, :21], fingers], axis=1)
    posed = forward_kinematics(fingered, betas, exp_so3(played.global_orient), local, played.transl)
    parents = fingered.layout.parents
    return KnownMotion(posed, fingered.rest_joints(betas), parents, fingered.layout.joints, 30.0), fingers


def test_fingers_come_along(tmp_path: Path, body: Body) -> None:
    known, fingers = with_own_fingers(body, BETAS)
    done = bring(write_bvh(tmp_path / "clip.bvh", known), body)
    off = log_so3(exp_so3(finger_turns_of(done.motion)).swapaxes(-1, -2) @ fingers).reshape(len(fingers), 2, 5, 3, 3)
    degrees = np.rad2deg(np.linalg.norm(off, axis=-1))
    # The file's last bones have no ends: where they point at rest is assumed.
    assert np.sqrt((degrees[..., :2] ** 2).mean()) < 2.0 and degrees[..., :2].max() < 8.0
    assert np.sqrt((degrees[..., 2] ** 2).mean()) < 6.0
    assert done.motion.resting is None
    again = np.linalg.norm(done.motion.joints - known.posed.joints, axis=-1)
    assert again[:, 22:].max() < 0.02


def test_fingers_that_never_turn_leave_the_motion_as_it_was(tmp_path: Path, body: Body) -> None:
    known, _ = with_own_fingers(body, BETAS)
    G = known.posed.G.copy()
    G[:, 22:37], G[:, 37:] = G[:, 20:21], G[:, 21:22]
    still = replace(known, posed=replace(known.posed, G=G))
    assert bring(write_bvh(tmp_path / "clip.bvh", still), body).motion.body_layout == SMPL


def test_a_body_without_finger_joints_takes_the_body_alone(tmp_path: Path, body: Body) -> None:
    known, _ = with_own_fingers(body, BETAS)
    path = write_bvh(tmp_path / "clip.bvh", known)
    assert bring(path, replace(body, id="another")).motion.body_layout == SMPL


def test_a_rare_shape_whose_joints_fit_is_no_warning(tmp_path: Path, body: Body, known: KnownMotion) -> None:
    """Skeletons of characters have rare proportions. They are a fault only if the body cannot take them."""
    done = bring(write_bvh(tmp_path / "clip.bvh", known), body)
    rare = replace(done, motion=replace(done.motion, betas=np.full(10, 5.5)))
    far = replace(rare, distances_mm=dict.fromkeys(rare.distances_mm, 19.0))
    assert "shape_odd" not in codes(_found_in(rare)) and "shape_odd" in codes(_found_in(far))


@pytest.mark.parametrize(("pose", "most_mm"), [("fight02", 5.0), ("fly02", 4.0), ("run01", 2.0)])
def test_hips_and_shoulders_of_another_trunk_are_reached(shared_data: Path, pose: str, most_mm: float) -> None:
    """Lengths alone leave the collars of MakeHuman's skeleton 11 mm off in these poses."""
    path = shared_data / f"makehuman_assets_cc0/base/poses/{pose}.bvh"
    brought = read_foreign_motion(path, "neutral", silent)
    assert brought.limbs_mm < most_mm and np.abs(brought.done.motion.betas).max() < 3.0


def test_a_first_frame_far_below_leaves_a_short_clip_on_its_floor(body: Body) -> None:
    """Some programs write a T-pose with the hips at the origin before the motion."""
    betas = np.zeros(10)
    x, y, z = body.rest_joints(betas)[: SMPL.num_joints].T
    joints = np.tile(np.stack([x, -z, y], axis=-1), (30, 1, 1))
    floor = floor_height(body, betas, joints)
    joints[0, :, 2] -= 0.9
    assert floor_height(body, betas, joints) == pytest.approx(floor, abs=1e-6)
