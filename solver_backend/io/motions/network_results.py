"""Read the results of networks that estimate or generate human motion.

The layouts come from these public repositories: GVHMR (zju3dv/GVHMR 44fbc19), GEM-X (NVlabs/GEM-X 3299255, the 77 SOMA
joints), WHAM (yohanshin/WHAM 2b54f77), OpenCap Monocular (opencap-monocular as of August 2026, ``NAME_optimized.pkl``),
TRAM (yufu-wang/tram 4861c11), PromptHMR (yufu-wang/PromptHMR ea85d0a), 4D-Humans (brjathu/PHALP 96f7e6c), SAM 3D Body
(facebookresearch/sam-3d-body b5c765a), InstantHMR (mohamdev/InstantHMR 6f841fc), MediaPipe 0.10 (world landmarks),
RTMW3D (open-mmlab/mmpose 1.3, projects/rtmpose3d) and MotionBERT (Walter0807/MotionBERT dccfe7b, ``X3D.npy``).

Generated motions are also supported: vectors and joints of HumanML3D (Guo et al. 2022), and MDM (Tevet et al. 2023). So
are pickled SMPL motions from AIST++ (Li et al. 2021), EDGE (Tseng et al. 2023) and AMASS, and pickled smplx arguments.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.body.files.restricted_pickle import finished
from solver_backend.exchange.errors import FileDamaged, MocapError, MotionInvalid, NonFiniteData
from solver_backend.exchange.joint_sets import HAND_COLUMNS, JointSet
from solver_backend.exchange.json_file import parse_json
from solver_backend.exchange.npz import read_npz
from solver_backend.exchange.plausible import require_within
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.files import LARGEST_TAKE, as_text, first_bytes, load_array, npz_names, read_text
from solver_backend.io.packed_values import SUFFIXES, numbers, read_packed
from solver_backend.types.network_result import CAMERA_TO_Z_UP, NUM_TURNED, Y_UP_TO_Z_UP, NetworkResult

_FINGERS = 30  # Number of finger joints in SMPL-H and SMPL-X, left hand first.
_FARTHEST_M, _MOST_TURN = 1e4, 1e3  # Largest position in metres, and largest rotation parameter.

_DAMAGE = (ValueError, TypeError, KeyError, IndexError, AttributeError, StopIteration, ArithmeticError)
_DAMAGE += (RuntimeError, MemoryError)


@dataclass(frozen=True)
class _RotationLayout:
    """Location of joint rotations in a network's file. Paths are keys joined by slashes, where * is any person."""

    program: str
    people: str  # Path of a person's dictionary, or "" for the whole file.
    camera: tuple[str, str, str]  # Paths of: pelvis (or all) rotations, joint rotations ("" if included), position.
    world: tuple[str, str] = ("", "")  # Paths of the pelvis (or all) rotations and the position, in a world with Y up.
    frames: str = ""  # Path of the frame numbers. "" numbers them from 0.
    to_camera: str = ""  # Path of the rotation from world to camera if the file has only world rotations.


_WORLD = ("pose_world", "trans_world")
_LAYOUTS = (
    *(
        _RotationLayout(
            program,
            "",
            (f"{group}_incam/global_orient", f"{group}_incam/body_pose", f"{group}_incam/transl"),
            (f"{group}_global/global_orient", f"{group}_global/transl"),
        )
        for program, group in (("GVHMR", "smpl_params"), ("GEM-X", "body_params"))
    ),
    _RotationLayout(
        "PromptHMR",
        "people/*",
        ("smplx_cam/pose", "", "smplx_cam/trans"),
        ("smplx_world/pose", "smplx_world/trans"),
        "frames",
    ),
    _RotationLayout("TRAM", "", ("pred_rotmat", "", "pred_trans"), frames="frame"),
    _RotationLayout(
        "OpenCap Monocular", "*", ("pose_world", "", "trans_world"), ("pose_world", "trans_world"), "frame_ids", "cam_R"
    ),
    _RotationLayout("WHAM", "*", ("pose", "", "trans"), ("pose_world", "trans_world"), "frame_ids"),
)
"""Layouts, tried in this order. The first layout with all of its paths in the file is used."""
_SMPL = (
    ("smpl_poses", "smpl_trans"),
    ("poses", "trans"),
    ("pose", "trans"),
    ("global_orient", "body_pose", "transl"),
)
"""Keys of the rotations and the position in a pickled SMPL motion, in a world with any up axis."""
_SMPL_HANDS, _SMPL_RATES = ("left_hand_pose", "right_hand_pose"), ("mocap_framerate", "mocap_frame_rate", "fps")
_SMPL_LEAN = 0.7  # Tangent of the mean lean above which the up axis is unknown: 35°, chosen by hand.
_SOMA = 77
_SOMA_OF = (0, 67, 72, 1, 68, 73, 2, 69, 74, 3, 70, 75, 4, 11, 39, 6, 12, 40, 13, 41, 14, 42)
"""SOMA joint for each of SMPL's 22 joints. Joint 5, SOMA's second neck joint, rotates the head together with 6."""
_SOMA_FINGERS = tuple(
    (joint - 1, joint) if joint == first and first not in (15, 43) else (joint,)
    for hand in (0, 28)
    for first in (20 + hand, 25 + hand, 35 + hand, 30 + hand, 15 + hand)
    for joint in range(first, first + 3)
)
"""SOMA joints for SMPL-X's index, middle, little and ring finger and thumb. Metacarpals rotate with the first joint."""
_MHR_BODY = tuple(name for name in JointSet.COCO_WHOLEBODY_133.keypoints if not name.endswith("wrist"))
_MHR = (*_MHR_BODY, *[""] * 20, "right_wrist", *[""] * 20, "left_wrist", *[""] * 6, "neck")
"""Names of the 70 MHR points, '' for hand points and inner elbow points."""
_MHR_HANDS = tuple((wrist, *(wrist - 20 + 4 * f + 3 - k for f in range(5) for k in range(4))) for wrist in (62, 41))
"""Columns of the 21 points of the left and right hand: the wrist, then each finger from base to tip."""
_POINTS = {
    70: ("SAM 3D Body", _MHR),
    17: ("MotionBERT", JointSet.H36M_17.keypoints),
    33: ("MediaPipe", JointSet.MEDIAPIPE_33.keypoints),
    133: ("RTMW3D", JointSet.COCO_WHOLEBODY_133.keypoints),
}
"""Program and point names for each number of points."""
_GENERATED = JointSet.SMPL_24.keypoints[:NUM_TURNED]
"""Names of the 22 joints of HumanML3D and MDM, in a world with Y up."""
_GENERATED_FPS = 20.0  # Frames per second of HumanML3D, the usual training data.
_VECTOR = 263
"""Numbers per HumanML3D frame: root rotation, velocity and height (4), 21 joints (63), rotations, speeds, contacts."""
_POINT_KEYS = ("pred_keypoints_3d", "joints_3d")  # Keys of the points in SAM 3D Body and InstantHMR files.
_JSON = re.compile(r'world_?landmarks|"instance_info"', re.IGNORECASE)
_MOST_FRAMES = 1_000_000  # Largest span of frame numbers, as for captures.
_ROUNDING = 0.03  # Largest deviation of a rotation matrix from orthonormality. 16-bit numbers reach 0.01.
_HEAD = 1 << 16  # Number of bytes read to recognise a JSON layout.


def is_network_result(path: Path) -> bool:
    """Return whether a file's suffix, keys or array shape suggest a network result."""
    suffix = path.suffix.lower()
    if suffix in SUFFIXES:
        return path.is_file()
    if suffix == ".npz":
        return bool(npz_names(path) & set(_POINT_KEYS))
    if suffix == ".json":
        return bool(_JSON.search(as_text(first_bytes(path, _HEAD))))
    if suffix != ".npy" or not path.is_file():
        return False
    try:
        array = load_array(path)
    except FileDamaged:
        return b"|O'" in first_bytes(path, 128)
    if array.ndim == 2:
        return array.shape[1] == _VECTOR
    return array.ndim == 3 and array.shape[1:] in ((NUM_TURNED, 3), (17, 3), (33, 3), (33, 4), (33, 5), (70, 3))


def read_network_result(path: Path) -> tuple[NetworkResult, ...]:
    """Read all people in a network result, the one with the most frames first.

    Raises:
        UnsafePickle: the file requests a class or function that arrays do not need.
        FileMissing, FileDamaged: the file is missing or damaged, or does not match any layout.
        MotionInvalid, NonFiniteData: the file contains no person, or contains invalid numbers.
    """
    try:
        people = [_checked(person, path) for person in _people(path)]
    except MocapError:
        raise
    except _DAMAGE as error:
        what = str(error) or type(error).__name__
        what = f"The network result has an unexpected layout: {what}."
        raise FileDamaged(what, where=str(path), hint="Write the file again with the network.") from error
    if not people:
        raise MotionInvalid("The network result does not contain a person.", where=str(path))
    return tuple(sorted(people, key=lambda person: -len(person.frames)))


def _people(path: Path) -> list[NetworkResult]:
    suffix = path.suffix.lower()
    if suffix == ".json":
        return _people_of_json(parse_json(read_text(path, LARGEST_TAKE), path))
    if suffix == ".npz":
        return _of_points_file(read_npz(path, lambda name: name in (*_POINT_KEYS, "frame_idx")))
    content: Any = None
    if suffix == ".npy" and b"|O'" not in first_bytes(path, 128):
        array = load_array(path)
        if array.shape[1:] in ((_VECTOR,), (NUM_TURNED, 3)):
            joints = numbers(array).astype(np.float64)
            return [_generated("HumanML3D", "0", joints if joints.ndim == 3 else joints_of_vectors(joints, str(path)))]
        with np.errstate(invalid="ignore"):  # signalling NaN
            points = numbers(array).astype(np.float64)[..., :3]
        return [_of_points("0", np.arange(len(array)), points)]
    content = read_packed(path)
    if isinstance(content, list) and len(content) == 1:
        content = content[0]
    if isinstance(content, dict) and (samples := _samples(content)):
        return samples
    for layout in _LAYOUTS:
        people = list(_found(content, layout.people))
        needed = [text for text in (*layout.camera, *layout.world, layout.to_camera) if text]
        if people and all(_at(person, text) is not None for _, person in people for text in needed):
            return [_rotations(layout, name, person) for name, person in people]
    if isinstance(content, dict) and set(_POINT_KEYS) & content.keys():
        return _of_points_file({name: numbers(content[name]) for name in _POINT_KEYS if name in content})
    if isinstance(content, list) and content and set(_POINT_KEYS) & set(_first(content[0])):
        key = next(name for name in _POINT_KEYS if name in _first(content[0]))
        return _by_person(
            (f, str(i), numbers(one[key])) for f, all_ in enumerate(content) for i, one in enumerate(_list(all_))
        )
    if isinstance(content, dict) and content and all(_at(frame, "smpl") is not None for frame in content.values()):
        return _tracks(list(content.values()))
    if smpl := [_smpl(name, person, keys) for path in ("", "*") for keys, name, person in _of_smpl(content, path)]:
        return smpl
    held = ", ".join(map(str, list(content)[:8])) if isinstance(content, dict) else type(content).__name__
    known = ", ".join(
        dict.fromkeys(
            [layout.program for layout in _LAYOUTS] + [name for name, _ in _POINTS.values()] + ["MDM", "SMPL"]
        )
    )
    hint = f"Supported networks: {known} and 4D-Humans."
    raise FileDamaged(f"The layout of the network result is unknown. It contains {held}.", where=str(path), hint=hint)


def _list(value: Any) -> list[Any]:
    value = finished(value)
    return value if isinstance(value, list) else [value]


def _first(value: Any) -> Any:
    return (_list(value) or [{}])[0]


def _at(content: Any, path: str) -> Any:
    for key in path.split("/") if path else ():
        content = content.get(key) if isinstance(content, dict) else None
    return content


def _found(content: Any, path: str) -> Iterator[tuple[str, dict[str, Any]]]:
    holder = _at(content, path.rstrip("*").rstrip("/"))
    if not isinstance(holder, dict):
        return
    for name, person in holder.items() if path.endswith("*") else [("0", holder)]:
        if isinstance(person, dict):
            yield str(name), person


def _rotations(layout: _RotationLayout, name: str, person: dict[str, Any]) -> NetworkResult:
    turns, *rest = [numbers(_at(person, text)) for text in layout.camera if text]
    places = rest[-1].reshape(-1, 3)
    turns = np.concatenate([_matrices(turns), _matrices(rest[0])], axis=1) if len(rest) > 1 else _matrices(turns)
    frames = numbers(_at(person, layout.frames)) if layout.frames else np.arange(len(turns))
    world = None
    if layout.world[0]:
        world = _matrices(numbers(_at(person, layout.world[0])))[:, 0]
        places = numbers(_at(person, layout.world[1])).reshape(-1, 3)
    if layout.to_camera:
        turns = turns.copy()
        turns[:, 0] = numbers(_at(person, layout.to_camera)).reshape(-1, 3, 3) @ turns[:, 0]
    return _of_turns(layout.program, name, frames, turns, world, places)


def _of_smpl(content: Any, path: str) -> Iterator[tuple[tuple[str, ...], str, dict[str, Any]]]:
    for name, person in _found(content, path):
        keys = next((keys for keys in _SMPL if all(key in person for key in keys)), None)
        if keys is not None:
            yield keys, name, person


def _smpl(name: str, person: dict[str, Any], keys: tuple[str, ...]) -> NetworkResult:
    """Convert an SMPL motion. The axis along which the person stands is the up axis.

    Raises ``ValueError`` if the person does not stand most of the time.
    """
    turns = np.concatenate([_matrices(numbers(person[key])) for key in keys[:-1]], axis=1)
    hands = [numbers(person[key]) for key in _SMPL_HANDS if key in person]
    if len(hands) == 2 and all(hand.size == 45 * len(turns) for hand in hands):
        turns = np.concatenate([turns, *map(_matrices, hands)], axis=1)
    scale = float(numbers(person.get("smpl_scaling", 1.0)).reshape(-1)[0])
    fps = next((float(numbers(person[key]).reshape(-1)[0]) for key in _SMPL_RATES if key in person), None)
    mean = turns[:, 0, :, 1].mean(axis=0)
    up = int(np.argmax(np.abs(mean)))
    if np.sort(np.abs(mean))[1] > _SMPL_LEAN * abs(mean[up]):
        raise ValueError("its person does not stand, so its up axis is unknown")
    axis = np.sign(mean[up]) * np.eye(3)[up]
    turn = (
        np.asarray(exp_so3(0.5 * np.pi * np.cross(axis, [0.0, 1.0, 0.0]))) if up != 1 else np.diag([1.0, *axis[[1, 1]]])
    )
    transl = numbers(person[keys[-1]]).reshape(-1, 3) / scale @ turn.T
    program = f"SMPL, {'-' if mean[up] < 0 else ''}{'XYZ'[up]} up"
    made = _of_turns(program, name, np.arange(len(turns)), turns, turn @ turns[:, 0], transl)
    return replace(made, fps=fps)


def _matrices(values: np.ndarray) -> np.ndarray:
    """Convert rotation vectors or matrices to rotation matrices (F, J, 3, 3)."""
    values = np.asarray(values, np.float64)
    if values.ndim >= 3 and values.shape[-2:] == (3, 3):
        return values.reshape(len(values), -1, 3, 3)
    if np.nanmax(np.abs(values), initial=0.0) > _MOST_TURN:
        raise ValueError("its rotation vectors are too large")
    return np.asarray(exp_so3(values.reshape(len(values), -1, 3)))


def _of_turns(
    program: str, name: str, frames: np.ndarray, turns: np.ndarray, world: np.ndarray | None, transl: np.ndarray
) -> NetworkResult:
    """Convert joint rotations of SMPL, SMPL-H, SMPL-X or SOMA to a result with SMPL joint rotations."""
    fingers = None
    if turns.shape[1] == _SOMA:
        turns = turns.copy()
        turns[:, 6] = turns[:, 5] @ turns[:, 6]
        first, last = (np.array([joints[end] for joints in _SOMA_FINGERS]) for end in (0, -1))
        fingers = np.where((first == last)[:, None, None], turns[:, last], turns[:, first] @ turns[:, last])
        local = turns[:, _SOMA_OF]
    else:
        local = turns[:, :NUM_TURNED]
        fingers = turns[:, -_FINGERS:] if turns.shape[1] >= NUM_TURNED + _FINGERS else None
    if local.shape[1] < NUM_TURNED:
        raise ValueError(f"it has rotations for {local.shape[1]} joints, but {NUM_TURNED} are expected")
    if fingers is not None and np.abs(fingers - np.eye(3)).max() < 1e-6:
        fingers = None
    level = None if world is None else Y_UP_TO_Z_UP @ world
    transl = transl @ (Y_UP_TO_Z_UP if world is not None else CAMERA_TO_Z_UP).T
    return NetworkResult(program, name, frames, local, fingers, level, transl)


def _tracks(frames: list[dict[str, Any]]) -> list[NetworkResult]:
    """Collect the people in PHALP's frames, which list each track's rotations and camera."""
    seen: dict[str, list[tuple[int, Any, Any]]] = {}
    for number, frame in enumerate(frames):
        for k, track in enumerate(frame.get("tid", [])):
            if isinstance(smpl := frame["smpl"][k], dict):
                seen.setdefault(str(track), []).append((int(frame.get("time", number)), smpl, frame["camera"][k]))
    found = []
    for name, rows in seen.items():
        turns = [
            np.concatenate([numbers(s[key]).reshape(-1, 3, 3) for key in ("global_orient", "body_pose")])
            for _, s, _ in rows
        ]
        places = np.array([numbers(camera).reshape(-1)[:3] for _, _, camera in rows])
        found.append(_of_turns("4D-Humans", name, np.array([f for f, _, _ in rows]), np.array(turns), None, places))
    return found


def _of_points_file(arrays: dict[str, np.ndarray]) -> list[NetworkResult]:
    key = next(name for name in _POINT_KEYS if name in arrays)
    with np.errstate(invalid="ignore"):  # signalling NaN
        values = numbers(arrays[key]).astype(np.float64)
    values = values[None] if values.ndim == 2 else values
    if values.ndim == 4:
        return _by_person((f, str(i), one) for f, all_ in enumerate(values) for i, one in enumerate(all_))
    frames = numbers(arrays["frame_idx"]) if "frame_idx" in arrays else np.arange(len(values))
    return [_of_points("0", frames, values)]


def _by_person(rows: Any) -> list[NetworkResult]:
    """Group points (K, 3) by person, from rows of frame, name and points."""
    people: dict[str, list[tuple[int, np.ndarray]]] = {}
    for frame, name, points in rows:
        people.setdefault(name, []).append((frame, points))
    return [
        _of_points(name, np.array([f for f, _ in seen]), np.array([p for _, p in seen], np.float64))
        for name, seen in people.items()
    ]


def _of_points(name: str, frames: np.ndarray, points: np.ndarray) -> NetworkResult:
    count = points.shape[1]
    if count not in _POINTS or points.shape[2:] != (3,):
        raise ValueError(f"its points have the unknown shape {points.shape[1:]}")
    program, names = _POINTS[count]
    hands = points[:, np.array(_MHR_HANDS)] if count == 70 else None
    if count == 133:
        starts = HAND_COLUMNS[JointSet.COCO_WHOLEBODY_133, 133]
        hands = np.stack([points[:, start : start + 21] for start in starts], axis=1)
    kept = [k for k, label in enumerate(names) if label]
    return NetworkResult(
        program, name, frames, points=points[:, kept], names=tuple(names[k] for k in kept), hands=hands
    )


def _samples(content: dict[str, Any]) -> list[NetworkResult]:
    """Read the generated samples in MDM's ``results.npy``. S samples have joints (S, 22, 3, F)."""
    motion = finished(content.get("motion"))
    if not isinstance(motion, np.ndarray) or motion.ndim != 4 or motion.shape[1:3] != (NUM_TURNED, 3):
        return []
    joints = np.moveaxis(numbers(motion).astype(np.float64), -1, 1)
    lengths = numbers(content["lengths"]) if "lengths" in content else [joints.shape[1]] * len(joints)
    for s, n in enumerate(lengths):
        if not n > 0:
            raise MotionInvalid(
                f"Sample {s} has an impossible length of {n:g} frames.", hint="Generate the motion again."
            )
    return [_generated("MDM", str(s), one[: int(n)]) for s, (one, n) in enumerate(zip(joints, lengths, strict=True))]


def _generated(program: str, name: str, joints: np.ndarray) -> NetworkResult:
    points = joints * [1.0, -1.0, -1.0]  # the axes of a level camera
    return NetworkResult(program, name, np.arange(len(points)), points=points, names=_GENERATED, fps=_GENERATED_FPS)


def joints_of_vectors(vectors: np.ndarray, where: str = "") -> np.ndarray:
    """Convert HumanML3D vectors (F, 263) to joints (F, 22, 3) in metres with Y up.

    The first four values are r, x, z and the root's height. From one frame to the next, the root rotates by ``2 r``
    about Y and moves by (x, z) in its own axes. Joints are relative to the root's ground position and heading (Guo et
    al. 2022, section 5).

    Raises:
        NonFiniteData: a root or joint value is not a number.
    """
    wrong = np.flatnonzero(~np.isfinite(vectors[:, : 4 + 3 * (NUM_TURNED - 1)]).all(axis=1))
    if len(wrong):
        hint = "Generate or export the motion again."
        raise NonFiniteData("Positions contain NaN or infinite values.", where=f"{where}, frame {wrong[0]}", hint=hint)
    before = np.concatenate([np.zeros((1, 3)), vectors[:-1, :3]])[: len(vectors)]
    angle = 2.0 * np.cumsum(before[:, 0])
    c, s = np.cos(angle), np.sin(angle)
    to_world = np.zeros((len(vectors), 3, 3))
    to_world[:, 0, 0] = to_world[:, 2, 2] = c
    to_world[:, 0, 2], to_world[:, 2, 0], to_world[:, 1, 1] = -s, s, 1.0
    steps = np.stack([before[:, 1], np.zeros(len(vectors)), before[:, 2]], axis=1)
    ground = np.cumsum((to_world @ steps[..., None])[..., 0], axis=0)
    local = vectors[:, 4 : 4 + 3 * (NUM_TURNED - 1)].reshape(-1, NUM_TURNED - 1, 3)
    joints = ground[:, None] + local @ to_world.swapaxes(-1, -2)
    root = ground + np.stack([np.zeros(len(vectors)), vectors[:, 3], np.zeros(len(vectors))], axis=1)
    return np.concatenate([root[:, None], joints], axis=1)


def _people_of_json(content: Any) -> list[NetworkResult]:
    """Read the people in MMPose predictions, or in a list of MediaPipe frames."""
    if isinstance(content, dict) and "instance_info" in content:
        rows = [
            (f, str(i), _from_mmpose(numbers(one["keypoints"]).astype(np.float64)))
            for f, frame in enumerate(content["instance_info"])
            for i, one in enumerate(frame.get("instances", []))
        ]
        return _by_person(rows)
    frames = content if isinstance(content, list) else next(v for v in content.values() if isinstance(v, list))
    rows = []
    for f, frame in enumerate(frames):
        key = next((key for key in frame if re.fullmatch("(pose_?)?world_?landmarks", key, re.IGNORECASE)), None)
        landmarks = (frame[key] or []) if key else []
        landmarks = landmarks.get("landmark", []) if isinstance(landmarks, dict) else landmarks
        for i, one in enumerate(landmarks if landmarks and isinstance(landmarks[0], list) else [landmarks]):
            if one:
                rows.append((f, str(i), np.array([[p["x"], p["y"], p["z"]] for p in one], np.float64)))
    return _by_person(rows)


def _from_mmpose(points: np.ndarray) -> np.ndarray:
    """Convert points that MMPose writes as (-x, -z, -y), with the lowest point at height 0, to camera axes."""
    points = points.reshape(-1, points.shape[-1])
    return np.asarray(-points[:, [0, 2, 1]])


def _checked(person: NetworkResult, path: Path) -> NetworkResult:
    """Validate a person's numbers, and sort the frames."""
    where = f"{path}, person {person.person}"
    person = replace(person, frames=_frame_numbers(person.frames, where))
    count = len(person.frames)
    for name in ("local", "fingers", "world", "transl", "points", "hands"):
        values = getattr(person, name)
        if values is None:
            continue
        if len(values) != count:
            raise MotionInvalid(f"'{name}' has {len(values)} frames instead of {count}.", where=where)
        if name not in ("points", "hands") and not np.isfinite(values).all():
            raise NonFiniteData(f"'{name}' contains NaN or infinite values.", where=where)
        require_within(f"'{name}'", np.nan_to_num(values, posinf=0.0, neginf=0.0), _FARTHEST_M, NonFiniteData, where)
        if name in ("local", "fingers", "world") and not _are_rotations(values):
            raise MotionInvalid(f"Some matrices of '{name}' are not rotations.", where=where)
    if not count or (person.points is not None and not np.isfinite(person.points).any()):
        raise MotionInvalid("The network result has no frames with a person.", where=where)
    order = np.argsort(person.frames, kind="stable")
    order = order[np.concatenate([[True], np.diff(person.frames[order]) > 0])]
    return person.of_frames(order)


def _frame_numbers(values: Any, where: str) -> np.ndarray:
    values = np.asarray(values)
    if values.ndim != 1 or values.dtype.kind not in "fiu" or not np.isfinite(values).all() or (values < 0).any():
        raise MotionInvalid("The frame numbers must be a list of numbers from 0.", where=where)
    if len(values) and max(values.max() - values.min(), len(values) - 1) >= _MOST_FRAMES:
        message = f"The frame numbers span more than {_MOST_FRAMES:,} frames."
        raise MotionInvalid(message, where=where)
    if len(values) and values.max() >= 2**31:
        raise MotionInvalid(f"The result has the impossible frame number {values.max():.0f}.", where=where)
    return values.astype(int)


def _are_rotations(values: np.ndarray) -> bool:
    products = np.swapaxes(values, -1, -2) @ values
    upright = (np.linalg.det(values) > 0).all()
    return bool(upright and np.abs(products - np.eye(3)).max(initial=0.0) < _ROUNDING)
