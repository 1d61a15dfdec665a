"""A take of one camera as the camera sees it and from the side, where its deviations are: along the line of sight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.fitters.one_view.depth import LIMB_ENDS
from solver_backend.geometry.symmetric import unpacked
from solver_backend.report.checks import recorded_diagnostics
from solver_backend.report.markup import section, text
from solver_backend.report.plots import WIDTH, strip_plot
from solver_backend.types import Capture, Motion

MOMENTS = 4
"""Moments that are drawn, one of each equal part of the take: where it knows least along the line of sight."""
ROW, MARGIN, CAPTION = 230.0, 8.0, 20.0
"""Height of a row of drawings, its edges and the line of text above, in units of the drawing."""
ELLIPSE = 5.991**0.5
"""Standard deviations of an ellipse that holds 95 % of a normal distribution in the plane (chi square, 2 degrees)."""
OPEN_CODES = ("limb_depth_open",)
"""Diagnostics that name limbs whose depth is open."""
TRUNK = "pelvis"
_LEAD = (
    "Ellipses hold 95 %: of hands, feet and head in colour, of the pelvis in grey. All joints share the grey one, "
    "with the person's distance and size. Dashed limbs are open in depth: they may point towards the camera or away. "
    "From the side the camera is on the left."
)


@dataclass(frozen=True)
class _SideProjection:
    """A parallel projection: from metres about the pelvis to a column of the drawing."""

    axes: np.ndarray
    """(2, 3) to the right and up."""
    left: float
    top: float
    scale: float
    """Units of the drawing a metre."""
    middle: np.ndarray
    """(2,) metres."""
    width: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        flat = (points @ self.axes.T - self.middle) * self.scale * [1.0, -1.0]
        return flat + [self.left + self.width / 2, self.top + ROW / 2]

    def ellipse(self, centre: np.ndarray, covariance: np.ndarray, kind: str, name: str) -> str:
        """Return the ellipse of a joint's (3, 3) covariance about its place."""
        values, vectors = np.linalg.eigh(self.axes @ covariance @ self.axes.T)
        short, long = ELLIPSE * self.scale * np.sqrt(np.maximum(values, 0.0))
        turn = -np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        x, y = self(centre)
        return (
            f'<ellipse class="{kind}" cx="{x:.1f}" cy="{y:.1f}" rx="{long:.1f}" ry="{short:.1f}" '
            f'transform="rotate({turn:.1f} {x:.1f} {y:.1f})"><title>{text(name)}</title></ellipse>'
        )


def one_view_section(capture: Capture, motion: Motion) -> str:
    """Return the camera's view beside the side view, and when the depth of which limb is open."""
    if not capture.is_one_view or capture.cameras is None or motion.joint_covariance is None:
        return ""
    assert capture.keypoints is not None
    view = int(np.flatnonzero((capture.keypoints.confidence > 0).any(axis=(1, 2)))[0])
    is_open = open_limbs(motion)
    sigma = sight_sigma_m(motion, capture.cameras.centres[view])
    frames = _moments(np.nan_to_num(sigma).max(axis=1))
    drawing = _drawing(motion, capture.cameras.centres[view], frames, is_open)
    rows = [(part, flags.astype(float)) for part, flags in is_open.items()]
    strip = strip_plot(rows, motion.fps)
    body = f"{drawing}<h3>Limbs whose depth is open</h3>{strip}"
    return section("From the camera and from the side", body, _LEAD, "side")


def open_limbs(motion: Motion) -> dict[str, np.ndarray]:
    """Return for each limb the (F,) frames in which its depth was reported as open."""
    found = {part: np.zeros(motion.num_frames, dtype=bool) for part in LIMB_ENDS.values()}
    for item in recorded_diagnostics(motion):
        part = item.values.get("part")
        if item.code in OPEN_CODES and part in found:
            for first, last in item.where.frames:
                found[part][first : last + 1] = True
    return found


def sight_sigma_m(motion: Motion, centre: np.ndarray) -> np.ndarray:
    """Return (F, J) standard deviations of the joints along the line of sight, metres.

    Args:
        motion: with covariances.
        centre: (3,) the camera's place.
    """
    assert motion.joint_covariance is not None
    away = motion.joints - centre
    sight = away / np.linalg.norm(away, axis=-1, keepdims=True)
    covariance = unpacked(motion.joint_covariance.astype(np.float64))
    return np.sqrt(np.einsum("fja,fjab,fjb->fj", sight, covariance, sight))


def _moments(worth: np.ndarray) -> list[int]:
    parts = [part for part in np.array_split(np.arange(len(worth)), MOMENTS) if len(part)]
    return [int(part[worth[part].argmax()]) for part in parts]


def _drawing(motion: Motion, centre: np.ndarray, frames: list[int], is_open: dict[str, np.ndarray]) -> str:
    width, names = WIDTH / len(frames), motion.body_layout.joints
    root = names.index(TRUNK)
    sides = [_axes(motion.joints[frame, root] - centre) for frame in frames]
    about = [motion.joints[frame] - motion.joints[frame, root] for frame in frames]
    assert motion.joint_covariance is not None
    covariances = [unpacked(motion.joint_covariance[frame].astype(np.float64)) for frame in frames]
    corners = [
        _corners(points, covariance, axes)
        for points, covariance, both in zip(about, covariances, sides, strict=True) for axes in both
    ]  # fmt: skip
    low, high = np.min([c[0] for c in corners], axis=0), np.max([c[1] for c in corners], axis=0)
    scale = float(min((width - 2 * MARGIN) / (high - low)[0], (ROW - 2 * MARGIN) / (high - low)[1]))
    parts = []
    for column, frame in enumerate(frames):
        for row, (axes, name) in enumerate(zip(sides[column], ("from the camera", "from the side"), strict=True)):
            top = CAPTION + row * (ROW + CAPTION)
            view = _SideProjection(axes, column * width, top, scale, (low + high) / 2, width)
            message = f"frame {frame} · {frame / motion.fps:.2f} s, {name}"
            parts.append(f'<text class="x" x="{view.left + width / 2:.0f}" y="{top - 6:.0f}">{message}</text>')
            open_now = {part for part, flags in is_open.items() if flags[frame]}
            floor = -motion.joints[frame, root, 2] if row == 1 else None
            parts += _person(view, about[column], covariances[column], motion, open_now, floor)
    height = 2 * (ROW + CAPTION)
    return f'<figure class="sides"><svg viewBox="0 0 {WIDTH:g} {height:g}" role="img">{"".join(parts)}</svg></figure>'


def _axes(sight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the (2, 3) axes of the picture, and of the side view: away from the camera over the floor, and up."""
    sight = sight / np.linalg.norm(sight)
    right = np.cross(sight, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
    return np.stack([right, np.cross(right, sight)]), np.stack([np.cross([0.0, 0.0, 1.0], right), [0.0, 0.0, 1.0]])


def _corners(points: np.ndarray, covariance: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest place on each axis that a person and their ellipses reach, metres."""
    flat, reach = points @ axes.T, ELLIPSE * np.sqrt(np.einsum("ka,jab,kb->jk", axes, covariance, axes))
    return (flat - reach).min(axis=0), (flat + reach).max(axis=0)


def _person(
    view: _SideProjection, points: np.ndarray, covariance: np.ndarray, motion: Motion, open_now: set[str],
    floor: float | None,
) -> list[str]:  # fmt: skip
    names, parts = motion.body_layout.joints, []
    if floor is not None:
        y = float(view(np.array([0.0, 0.0, floor]))[1])
        right = view.left + view.width
        parts.append(f'<line class="axis" x1="{view.left:.1f}" x2="{right:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>')
    for end in (TRUNK, *LIMB_ENDS):
        if end in names:
            joint = names.index(end)
            parts.append(view.ellipse(points[joint], covariance[joint], f"spread {_side(end)}", end.replace("_", " ")))
    for joint, parent in enumerate(motion.body_layout.parents):
        if parent >= 0:
            kind = f"bone {_side(names[joint])}" + (" open" if _limb_of(names[joint]) in open_now else "")
            (x1, y1), (x2, y2) = view(points[[parent, joint]])
            parts.append(f'<line class="{kind}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>')
    return parts


def _side(joint: str) -> str:
    """Return the class of the side's colour."""
    return {"left": "a", "right": "b"}.get(joint.partition("_")[0], "c")


def _limb_of(joint: str) -> str:
    """Return which limb a bone that ends in this joint belongs to, "" for none."""
    side, _, part = joint.partition("_")
    limb = {"elbow": "arm", "wrist": "arm", "hand": "arm", "knee": "leg", "ankle": "leg", "foot": "leg"}.get(part)
    return f"{side} {limb}" if limb else ("head" if joint == "head" else "")
