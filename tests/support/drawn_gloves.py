"""Recordings of gloves drawn after their makers' public documents, beside a body's motion, with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.hand_skeleton import ANGLES, NUM_ANGLES, HandSkeleton, PosedHand
from solver_backend.body.kinematics import PosedSkeleton, forward_kinematics
from solver_backend.exchange.joint_sets import FINGERS
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.hand_prior import load_hand_prior
from solver_backend.synthesis.embedded.demo import author_motion
from solver_backend.types import Motion
from tests.support.bvh_texts import KnownMotion, write_bvh
from tests.support.moving_hand import smooth
from tests.support.open_hand import open_hand

FINE, BODY_FPS, GLOVE_FPS = 600, 30.0, 100.0  # Samples a second of the truth, and what each recording keeps of them.
SECONDS = 6.0
OFFSET_S = 0.85
"""Second of the motion at which the gloves begin."""
_AROUND = exp_so3(np.array([[0.0, np.pi / 2, 0.0], [0.0, -np.pi / 2, 0.0]]))
"""A flat hand's axes to those of a person's T-pose, left and right."""
_WORLD = exp_so3(np.array([0.4, -1.1, 0.7]))  # The gloves' world is another than the body's.


@dataclass(frozen=True)
class DrawnGloves:
    """A body's motion without fingers, and hands that gloves recorded beside it."""

    motion: Motion
    times: np.ndarray
    """(G,) seconds of the gloves' frames from their first."""
    angles: np.ndarray
    """(F, 2, A) radians of the motion's frames: the truth."""
    glove_angles: np.ndarray
    """(G, 2, A) of the gloves' frames."""
    points: np.ndarray
    """(G, 2, 21, 3) metres in the gloves' world."""
    posed: tuple[PosedHand, PosedHand]
    """Of the gloves' frames, each in its own hand's frame."""
    wrists: np.ndarray
    """(G, 2, 3, 3) rotations of the hands in the gloves' world."""


def drawn_gloves(seed: int = 0, shakes: bool = True) -> DrawnGloves:
    """Return the embedded choreography with wrists that wave, and gloves that begin later.

    Args:
        seed: of the fingers.
        shakes: the wrists turn; they rest in the gloves' world otherwise, as where gloves have no orientation.
    """
    body, rng = load_body(), np.random.default_rng(seed)
    count = round(SECONDS * FINE)
    played = author_motion(body, np.zeros(10), count, float(FINE))
    pose = played.body_pose.reshape(count, -1, 3)[:, :23].copy()
    t = np.arange(count) / FINE
    waves = _waves(t, 6, rng).reshape(count, 2, 3)
    pose[:, 19:21] += 0.5 * waves
    prior = load_hand_prior()
    drawn = (
        prior.mean
        + 0.6 * np.stack([_waves(t, NUM_ANGLES, rng) for _ in range(2)], 1) @ np.linalg.cholesky(prior.covariance).T
    )
    angles = np.clip(drawn, prior.low, prior.high)
    angles[..., ANGLES.index("thumb_cmc_twist")] = 0.0  # points do not show it
    kept = slice(0, None, round(FINE / BODY_FPS))
    posed = forward_kinematics(body, np.zeros(10), exp_so3(played.global_orient), exp_so3(pose), played.transl)
    motion = Motion(
        np.zeros(10), played.global_orient[kept], np.pad(pose[kept].reshape(len(pose[kept]), -1), ((0, 0), (0, 6))),
        played.transl[kept], BODY_FPS, body.id, posed.joints[kept],
    )  # fmt: skip
    of_gloves = slice(round(OFFSET_S * FINE), None, round(FINE / GLOVE_FPS))
    own = angles[of_gloves]
    turned = posed.G[of_gloves][:, [20, 21]] if shakes else np.tile(np.eye(3), (len(own), 2, 1, 1))
    wrists = _WORLD @ turned @ _AROUND
    skeletons = [HandSkeleton.of_points(open_hand(side), side) for side in range(2)]
    hands = tuple(skeleton.pose(own[:, side]) for side, skeleton in enumerate(skeletons))
    points = np.zeros((len(own), 2, 21, 3))
    for side, hand in enumerate(hands):
        points[:, side, 1:] = hand.joints.reshape(len(own), 20, 3)
    points = (wrists[:, :, None] @ points[..., None])[..., 0] + [0.0, 1.0, 0.0]
    return DrawnGloves(motion, np.arange(len(own)) / GLOVE_FPS, angles[kept], own, points, (hands[0], hands[1]), wrists)


def _waves(t: np.ndarray, width: int, rng: np.random.Generator) -> np.ndarray:
    """Return (n, width) slow waves; see ``smooth``, whose samples are 30 a second."""
    coarse = smooth(round(SECONDS * 30) + 2, width, rng)
    grid = np.arange(len(coarse)) / 30.0
    return np.stack([np.interp(t, grid, column) for column in coarse.T], axis=1)


def hands_bvh(path: Path, drawn: DrawnGloves, side: int, name: str, *, metacarpals: bool = False) -> Path:
    """Write a hand alone as BVH: the root is the wrist, tips are joints.

    Args:
        path: the file.
        drawn: the recording.
        side: 0 left, 1 right.
        name: of joints, with ``{finger}`` and ``{number}``, such as ``LeftHand{finger}{number}``.
        metacarpals: bones of the palm before the fingers, as Noitom's ``LeftInHandIndex``.
    """
    hand, rest = drawn.posed[side], HandSkeleton.of_points(open_hand(side), side)
    frames = len(drawn.times)
    names, parents, places = [name.partition("{")[0]], [-1], [np.zeros(3)]
    G, joints = [drawn.wrists[:, side]], [drawn.points[:, side, 0]]
    flat = rest.points_at_rest[1:].reshape(5, 4, 3)
    for number, finger in enumerate(FINGERS):
        parent = 0
        if metacarpals and number:
            names.append(f"{name.partition('Hand')[0]}InHand{finger.title()}")
            parents.append(0)
            places.append(0.25 * flat[number, 0])
            G.append(drawn.wrists[:, side])
            joints.append(drawn.points[:, side, 0] + (drawn.wrists[:, side] @ places[-1]))
            parent = len(names) - 1
        for k in range(4):
            names.append(name.format(finger=finger.title(), number=k + 1))
            parents.append(parent)
            parent = len(names) - 1
            places.append(flat[number, k])
            turned = hand.frames[:, number, min(k, 2) + 1] @ np.swapaxes(rest.rest[number, min(k, 2)], -1, -2)
            G.append(drawn.wrists[:, side] @ turned)
            joints.append(drawn.points[:, side, 1 + 4 * number + k])
    known = KnownMotion(
        PosedSkeleton(np.stack(G, 1), np.stack(joints, 1)), np.array(places), tuple(parents), tuple(names), GLOVE_FPS
    )
    assert frames == len(known.posed.G)
    return write_bvh(path, known, turn=np.eye(3), order="YXZ")


def manus_csv(path: Path, drawn: DrawnGloves, side: int, *, ergonomics: bool = False, mirrored: bool = True) -> Path:
    """Write a hand as MANUS Core does: positions of 25 joints and the hand, or ergonomics' angles in degrees."""
    columns: dict[str, np.ndarray] = {}
    if ergonomics:
        for finger in FINGERS:
            parts = ("CMC_Spread", "CMC_Flex", "PIP_Flex", "DIP_Flex") if finger == "thumb" else (
                "MCP_Spread", "MCP_Flex", "PIP_Flex", "DIP_Flex"
            )  # fmt: skip
            for part in parts:
                own = {"CMC_Flex": None, "CMC_Spread": None, "MCP_Spread": None}.get(part, part)
                joint = (own or "").removesuffix("_Flex").lower()
                joint = {"pip": "mcp", "dip": "ip"}[joint] if finger == "thumb" and joint else joint
                angle = f"{finger}_{joint}_flexion"
                values = drawn.glove_angles[:, side, ANGLES.index(angle)] if own else np.full(len(drawn.times), 0.7)
                columns[f"{finger.title()}_{part}"] = np.rad2deg(values)
    else:
        points = drawn.points[:, side] * ([-1.0, 1.0, 1.0] if mirrored else [1.0, 1.0, 1.0])
        named = {"Hand": points[:, 0]}
        for number, finger in enumerate(FINGERS):
            joints = ("CMC", "MCP", "DIP", "TIP") if finger == "thumb" else ("MCP", "PIP", "DIP", "TIP")
            if finger != "thumb":
                named[f"{finger.title()}_CMC"] = 0.7 * points[:, 0] + 0.3 * points[:, 1 + 4 * number]
            named |= {f"{finger.title()}_{j}": points[:, 1 + 4 * number + k] for k, j in enumerate(joints)}
        columns = {f"{name}_{axis}": xyz[:, a] for name, xyz in named.items() for a, axis in enumerate("XYZ")}
    head = ["Frame", "Elapsed_Time_In_Milliseconds", "Time", *columns]
    rows = [",".join(head)]
    for f, second in enumerate(drawn.times):
        clock = f"03:08:{42 + int(second):02d}:{round(second % 1 * 1e4):04d}"
        rows.append(",".join([str(f), f"{1000 * second:.5f}", clock, *(f"{v[f]:.7g}" for v in columns.values())]))
    path.write_text("\n".join(rows) + "\n")
    return path


def rokoko_csv(path: Path, drawn: DrawnGloves, *, positions: bool = True) -> Path:
    """Write both hands as Rokoko Studio does: segments' positions in left-handed axes, joints' flexions in degrees."""
    columns: dict[str, np.ndarray] = {"Timestamp": 1000.0 * drawn.times}
    thumb = ("MetaCarpal", "ProximalPhalanx", "DistalPhalanx")
    others = ("ProximalPhalanx", "IntermediatePhalanx", "DistalPhalanx")
    joints = ("Metacarpophalangeal", "ProximalInterphalangeal", "DistalInterphalangeal")
    for side, word in enumerate(("Left", "Right")):
        named = {f"{word}Hand": drawn.points[:, side, 0]}
        for number in range(5):
            for k, segment in enumerate(others if number else thumb):
                named[f"{word}Digit{number + 1}{segment}"] = drawn.points[:, side, 1 + 4 * number + k]
        for name, xyz in named.items() if positions else ():
            for a, axis in enumerate("xyz"):
                columns[f"{name}_position_{axis}"] = xyz[:, a] * (-1.0 if axis == "x" else 1.0)
        for number, finger in enumerate(FINGERS):
            own = (
                zip(("mcp", "pip", "dip"), joints, strict=True) if number
                else (("mcp", "Metacarpophalangeal"), ("ip", "Interphalangeal"))
            )  # fmt: skip
            for joint, spelled in own:
                angle = ANGLES.index(f"{finger}_{joint}_flexion")
                columns[f"{word}Digit{number + 1}{spelled}_flexion"] = np.rad2deg(drawn.glove_angles[:, side, angle])
                columns[f"{word}Digit{number + 1}{spelled}_ulnarDeviation"] = np.zeros(len(drawn.times))
    rows = [",".join(columns)]
    rows += [",".join(f"{v[f]:.7g}" for v in columns.values()) for f in range(len(drawn.times))]
    path.write_text("\n".join(rows) + "\n")
    return path
