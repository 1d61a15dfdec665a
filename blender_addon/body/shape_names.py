"""What each shape direction of a body does, measured, so that its slider is named by it.

Every direction is taken one standard deviation either way and the body is measured. A direction is named by the measure
of which it has the largest share of the population's variance, ``d_mk^2 / sum_k d_mk^2``; no name is given twice.
"""

from __future__ import annotations

import numpy as np

from ..conventions.skeleton import NUM_BETAS
from .body_file import BodyFile, once_a_body

_UNNAMED = "detail"
_LEAST_SHARE = 0.02
"""Of a measure's variance, below which a direction is not named by it."""
_NAMES = {
    "stature": ("stature", "short stature"),
    "build": ("build", "slenderness"),
    "leg": ("leg length", "trunk length"),
    "arm": ("arm length", "short arms"),
    "shoulders": ("shoulder width", "narrow shoulders"),
    "hips": ("hip width", "narrow hips"),
    "head": ("neck and head", "short neck"),
    "thigh": ("thigh length", "shin length"),
    "upper_arm": ("upper arm length", "forearm length"),
    "trunk_depth": ("chest depth", "flat chest"),
    "thigh_girth": ("thigh girth", "slim thighs"),
    "arm_girth": ("arm girth", "slim arms"),
    "foot": ("foot length", "short feet"),
}  # fmt: skip
"""What a measure's growth is called, and its decline."""


@once_a_body
def shape_names(body: BodyFile) -> tuple[str, ...]:
    """Return what each of the ten shape directions does, in two or three words.

    A body whose skin cannot be measured (a stand-in of a few vertices) gets "detail" where nothing is found.
    """
    directions = np.eye(NUM_BETAS)
    changes = [_relative(_measures(body, e), _measures(body, -e)) for e in directions]
    table = np.array([[change[name] for name in _NAMES] for change in changes])
    shares = table**2 / np.maximum((table**2).sum(0), 1e-18)
    names, keys = [_UNNAMED] * NUM_BETAS, list(_NAMES)
    for place in np.argsort(-shares, axis=None, kind="stable").tolist():
        k, m = divmod(place, len(keys))
        if names[k] == _UNNAMED and shares[k, m] > _LEAST_SHARE and not set(_NAMES[keys[m]]) & set(names):
            names[k] = _NAMES[keys[m]][int(table[k, m] < 0)]
    return tuple(names)


def _relative(more: dict[str, float], less: dict[str, float]) -> dict[str, float]:
    """Return by what share each measure differs, 0 where it cannot be measured."""
    both = {name: (more[name] + less[name]) / 2 for name in more}
    return {name: (more[name] - less[name]) / mean if mean > 1e-6 else 0.0 for name, mean in both.items()}


def _measures(body: BodyFile, betas: np.ndarray) -> dict[str, float]:
    """Return lengths against the stature, and the build: volume over the square of the stature."""
    vertices, joints = body.shaped(betas), dict(zip(body.layout.joints, body.rest_joints(betas), strict=True))
    stature = float(np.ptp(vertices[:, 1]))
    corners = vertices[body.faces]
    volume = abs(float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])))) / 6

    def apart(a: str, b: str) -> float:
        return float(np.linalg.norm(joints[a] - joints[b]))

    thigh, shin = apart("left_hip", "left_knee"), apart("left_knee", "left_ankle")
    upper, forearm = apart("left_shoulder", "left_elbow"), apart("left_elbow", "left_wrist")
    shares = {
        "leg": thigh + shin, "arm": upper + forearm, "shoulders": apart("left_shoulder", "right_shoulder"),
        "hips": apart("left_hip", "right_hip"), "head": apart("neck", "head"),
        "foot": _reach(body, vertices, ("left_ankle", "left_foot"), 2),
        "trunk_depth": _reach(body, vertices, ("spine3",), 2),
        "thigh_girth": _radius(body, vertices, joints, "left_hip", "left_knee"),
        "arm_girth": _radius(body, vertices, joints, "left_shoulder", "left_elbow"),
    }  # fmt: skip
    return {
        "stature": stature, "build": volume / stature**2,
        "thigh": thigh / max(thigh + shin, 1e-9), "upper_arm": upper / max(upper + forearm, 1e-9),
        **{name: value / stature for name, value in shares.items()},
    }  # fmt: skip


def _skin_of(body: BodyFile, vertices: np.ndarray, joints: tuple[str, ...]) -> np.ndarray:
    return vertices[np.isin(body.weights.argmax(axis=1), [body.layout.joints.index(joint) for joint in joints])]


def _reach(body: BodyFile, vertices: np.ndarray, joints: tuple[str, ...], axis: int) -> float:
    skin = _skin_of(body, vertices, joints)
    return float(np.ptp(skin[:, axis])) if len(skin) else 0.0


def _radius(body: BodyFile, vertices: np.ndarray, joints: dict[str, np.ndarray], joint: str, end: str) -> float:
    """Return the mean distance of a limb's skin from its bone."""
    skin = _skin_of(body, vertices, (joint,)) - joints[joint]
    along = joints[end] - joints[joint]
    length = float(np.linalg.norm(along))
    if not len(skin) or length < 1e-6:
        return 0.0
    return float(np.linalg.norm(np.cross(skin, along / length), axis=1).mean())
