"""The page docs/reference/joint-sets.md: the keypoints of every joint set, in the order of their columns."""

from __future__ import annotations

from solver_backend.exchange.joint_sets import HAND_POINTS, JointSet

_HEAD = """<!-- Made by python3 dev.py docs from solver_backend/exchange/joint_sets.py; edit that. -->

# Joint sets

A joint set names the points that a detector finds. Give its name with `--joint-set`, or to
[your own detector](../how-to/add-a-detector.md). The table lists the points in the order of the detector's columns.
The column *points in a file* shows how many points the detector writes. Points after the listed ones belong to the
hands and the face. For other points, write a [`keypoints.json`](../how-to/choose-a-detector.md).

| name | points in a file | names of the points, in order |
|---|---|---|"""


def joint_sets_page() -> str:
    """Return the page."""
    rows = [f"| `{s}` | {' or '.join(map(str, s.num_written))} | {', '.join(s.keypoints)} |" for s in JointSet]
    return "\n".join([_HEAD, *rows, "", f"A hand has {len(HAND_POINTS)} points: {', '.join(HAND_POINTS)}.", ""])
