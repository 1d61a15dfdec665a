"""Generate docs/reference/joint-sets.md with the keypoints of every joint set, in column order."""

from __future__ import annotations

from solver_backend.exchange.joint_sets import HAND_POINTS, JointSet

_HEAD = """<!-- Made by python3 dev.py docs from solver_backend/exchange/joint_sets.py; edit that. -->

# Joint sets

A joint set names the points that a detector finds. If several sets fit your files, choose one with `--joint-set`. If a
file has more points than names, the other points belong to the hands and the face. For other points, write a
[`keypoints.json`](../how-to/choose-a-detector.md#your-own-keypoints-keypointsjson).

| name | points in a file | point names, in order |
|---|---|---|"""


def joint_sets_page() -> str:
    """Return the reference page of the joint sets."""
    rows = []
    for item in JointSet:
        same = next(other for other in JointSet if other.keypoints == item.keypoints)
        points = f"`{', '.join(item.keypoints)}`" if same is item else f"the same as `{same}`"
        rows.append(f"| `{item}` | {' or '.join(map(str, item.num_written))} | {points} |")
    return "\n".join([_HEAD, *rows, "", f"A hand has {len(HAND_POINTS)} points: `{', '.join(HAND_POINTS)}`.", ""])
