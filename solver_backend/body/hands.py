"""Bodies whose fingers move: our own with its hands' file, SMPL-H's and SMPL-X's with face at rest."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from solver_backend.body.body import DEFAULT_BODY, Body, load_body
from solver_backend.exchange.body_layout import SMPL, SMPL_H, SMPL_HANDS, BodyLayout
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.exchange.npz import read_npz
from solver_backend.types.shapes import Float

HANDS_FILE = DEFAULT_BODY.with_name("hands_neutral.npz")
"""Of the body that ships; see ``assets_procedural/hand``."""
FIRST_FINGER = 1 + SMPL.num_solved
"""The first finger joint of ``SMPL_HANDS``."""


def load_body_with_hands(path: Path | None = None) -> Body:
    """Read a body whose fingers move, of the layout ``SMPL_HANDS``: ours, or the one of a file.

    Raises:
        BodyInvalid: see ``load_body`` and ``with_fingers``.
    """
    return with_fingers(load_body(path))


@lru_cache(maxsize=4)
def with_fingers(body: Body) -> Body:
    """Return the body with finger joints that move; skin, shapes and the 22 body joints stay as they are.

    With fingers at rest our body is skinned as without them. SMPL-X's jaw and eyes rest: the head carries their skin.

    Raises:
        BodyInvalid: the body has no fingers and is not the one that ships.
    """
    if body.layout.joints == SMPL_HANDS.joints:
        return replace(body, layout=_moving(body.layout), hands_mean=None)
    if set(SMPL_H.joints) <= set(body.layout.joints):
        return _without_face(body)
    hands = read_npz(HANDS_FILE)
    if body.layout.joints != SMPL.joints or body.id != str(hands["body_id"]):
        raise BodyInvalid(
            f"The body {body.id} has no finger joints.", where=body.id,
            hint="Use the body that ships, or an SMPL-H or SMPL-X file.",
        )  # fmt: skip
    count, chosen = len(body.v_template), hands["vertices"].astype(np.int64)
    kept = slice(0, FIRST_FINGER)
    weights = np.zeros((count, SMPL_HANDS.num_joints))
    weights[:, kept] = body.weights[:, kept]
    weights[chosen] = hands["weights"]
    posedirs = np.zeros((count, 3, 9 * (SMPL_HANDS.num_joints - 1)))
    body_features = 9 * SMPL.num_solved
    posedirs[..., :body_features] = body.posedirs[..., :body_features]
    posedirs[chosen, :, body_features:] = hands["posedirs"]
    regressor = np.zeros((SMPL_HANDS.num_joints, count))
    regressor[kept] = body.J_regressor[kept]
    regressor[FIRST_FINGER:, chosen] = hands["J_regressor"]
    return replace(
        body, posedirs=posedirs, J_regressor=regressor, weights=weights / weights.sum(axis=1, keepdims=True),
        layout=SMPL_HANDS,
    )  # fmt: skip


def with_hand_size(body: Body, size: float) -> Body:
    """Return the body with larger or smaller hands: ``v + (size - 1) d``, see ``hand_size_directions``.

    Args:
        body: from ``with_fingers``.
        size: of the hands, relative to what the body's shape gives them.

    Raises:
        BodyInvalid: the size is not positive.
    """
    if not size > 0.0:
        raise BodyInvalid(f"Hands of relative size {size} cannot be; a positive number is expected.", where=body.id)
    directions = hand_size_directions(body.v_template, body.weights, body.joints_template)
    return replace(body, v_template=body.v_template + (size - 1.0) * directions)


def hand_size_directions(
    vertices: Float[np.ndarray, "vertices 3"], weights: Float[np.ndarray, "vertices 52"],
    joints: Float[np.ndarray, "52 3"],
) -> Float[np.ndarray, "vertices 3"]:  # fmt: skip
    """Return (V, 3) ``s (v - wrist)``, metres per unit of relative hand size; s rises with what a hand carries.

    Args:
        vertices: (V, 3) rest vertices, metres.
        weights: (V, 52).
        joints: (52, 3) rest joints, metres.
    """
    directions = np.zeros_like(vertices)
    for side in ("left", "right"):
        wrist = SMPL_HANDS.joints.index(f"{side}_wrist")
        share = weights[:, [wrist, *SMPL_HANDS.group(f"{side}_hand")]].sum(axis=1)
        # Smooth at both ends, so that the forearm runs into a larger hand without a step.
        directions += (share * share * (3.0 - 2.0 * share))[:, None] * (vertices - joints[wrist])
    return directions


def _moving(layout: BodyLayout) -> BodyLayout:
    return replace(SMPL_HANDS, parents=layout.parents)


def _without_face(body: Body) -> Body:
    """Return a body of SMPL-X's layout as one of ``SMPL_HANDS``; what jaw and eyes carry, the head does."""
    names = body.layout.joints
    kept = [names.index(name) for name in SMPL_HANDS.joints]
    weights = body.weights.copy()
    weights[:, names.index("head")] += weights[:, list(body.layout.group("face"))].sum(axis=1)
    features = body.posedirs.reshape(*body.posedirs.shape[:2], -1, 9)[:, :, [j - 1 for j in kept[1:]]]
    return replace(
        body, posedirs=features.reshape(*body.posedirs.shape[:2], -1), J_regressor=body.J_regressor[kept],
        weights=weights[:, kept], layout=SMPL_HANDS, hands_mean=None,
    )  # fmt: skip
