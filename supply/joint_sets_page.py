"""The page docs/reference/joint-sets.md: the keypoints of every joint set, in the order of their columns."""

from __future__ import annotations

from solver_backend.exchange.joint_sets import HAND_POINTS, JointSet

_HEAD = """<!-- Made by python3 dev.py docs from solver_backend/exchange/joint_sets.py; edit that. -->

# Joint sets

A joint set names the points of a detector, for `--joint-set` and for [your own detector](../how-to/add-a-detector.md).
Points are in the order of the detector's columns. *Written* is the number of points in the detector's files. Points
after the listed ones belong to hands and face. For other points, write a
[`keypoints.json`](../how-to/choose-a-detector.md).

| name | written | points in order |
|---|---|---|"""


def joint_sets_page() -> str:
    """Return the page."""
    rows = [f"| `{s}` | {' or '.join(map(str, s.num_written))} | {', '.join(s.keypoints)} |" for s in JointSet]
    return "\n".join([_HEAD, *rows, "", f"A hand has {len(HAND_POINTS)} points: {', '.join(HAND_POINTS)}.", ""])
