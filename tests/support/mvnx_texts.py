"""MVNX files of a known motion of our body, as Xsens writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.so3 import quat_from_matrix
from tests.support.bvh_texts import KnownMotion

R_STAGE_BODY = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
SEGMENTS = {
    "Pelvis": 0, "L5": 3, "L3": 6, "T8": 9, "Neck": 12, "Head": 15, "RightShoulder": 14, "RightUpperArm": 17,
    "RightForeArm": 19, "RightHand": 21, "LeftShoulder": 13, "LeftUpperArm": 16, "LeftForeArm": 18, "LeftHand": 20,
    "RightUpperLeg": 2, "RightLowerLeg": 5, "RightFoot": 8, "RightToe": 11, "LeftUpperLeg": 1, "LeftLowerLeg": 4,
    "LeftFoot": 7, "LeftToe": 10,
}  # fmt: skip
"""The joint of ours that each segment turns with, in MVN's order."""


def write_mvnx(path: Path, known: KnownMotion, *, kinds: tuple[str, ...] = ("identity", "tpose"), **edits: str) -> Path:
    """Write a motion as MVNX.

    Args:
        path: the file.
        known: the motion.
        kinds: types of the frames before the recording.
        edits: text that takes the place of another, by that other.
    """
    joints = list(SEGMENTS.values())
    rest = known.rest[joints] @ R_STAGE_BODY.T
    G = known.posed.G[:, joints] @ R_STAGE_BODY.T
    still = np.tile([1.0, 0.0, 0.0, 0.0], (len(joints), 1))
    frames = [(kind, still, rest) for kind in kinds]
    frames += [("normal", quat_from_matrix(turns), known.posed.joints[f, joints]) for f, turns in enumerate(G)]
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>', '<mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="4">',
        f'<subject label="A" frameRate="{known.fps:g}" segmentCount="{len(joints)}"><segments>',
        *(f'<segment label="{name}" id="{i + 1}"/>' for i, name in enumerate(SEGMENTS)),
        '</segments><frames>',
    ]  # fmt: skip
    for index, (kind, quats, places) in enumerate(frames):
        number = f' index="{index}"' if kind == "normal" else ""
        rows = [" ".join(f"{value:.6f}" for value in part.ravel()) for part in (quats, places)]
        lines.append(f'<frame type="{kind}"{number}><orientation>{rows[0]}</orientation>')
        lines.append(f"<position>{rows[1]}</position></frame>")
    text = "\n".join([*lines, "</frames></subject></mvnx>"])
    for old, new in edits.items():
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path
