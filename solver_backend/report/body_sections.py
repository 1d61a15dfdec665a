"""Write the sections about solves from a single camera and about hands."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.joint_sets import FINGERS, SIDES
from solver_backend.fitters.one_view.depth import LIMB_ENDS
from solver_backend.geometry.small_matrices import unpacked
from solver_backend.report.checks import recorded_diagnostics
from solver_backend.report.markup import facts, figure, heat_table, section, text
from solver_backend.report.plots import WIDTH, Projection, draw_line, moments, strip_plot
from solver_backend.types import Capture, Motion

MOMENTS = 4  # Number of drawn frames: from each equal part of the take, the one with the most uncertain depth.
ROW, MARGIN, CAPTION = 230.0, 8.0, 20.0
"""Height of a row of drawings, margin, and height of the line of text above the row, in drawing units."""
ELLIPSE = 5.991**0.5
"""Size of an ellipse that covers 95 % of a 2D normal distribution, in standard deviations (chi square, 2 degrees of
freedom)."""
OPEN_CODES = ("limb_depth_open",)  # Diagnostics about limbs with an ambiguous depth.
TRUNK = "pelvis"
_LEAD = (
    "Ellipses are 95 % confidence regions, coloured for hands, feet and head, and grey for the pelvis. The pelvis "
    "uncertainty, which includes the person's distance and size, applies to all joints. Dashed limbs could point "
    "towards the camera or away from it. In the side view, the camera is on the left."
)


def _ellipse(view: Projection, centre: np.ndarray, covariance: np.ndarray, kind: str, name: str) -> str:
    values, vectors = np.linalg.eigh(view.axes @ covariance @ view.axes.T)
    short, long = ELLIPSE * view.scale * np.sqrt(np.maximum(values, 0.0))
    turn = -np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    x, y = view(centre)
    return (
        f'<ellipse class="{kind}" cx="{x:.1f}" cy="{y:.1f}" rx="{long:.1f}" ry="{short:.1f}" '
        f'transform="rotate({turn:.1f} {x:.1f} {y:.1f})"><title>{text(name)}</title></ellipse>'
    )


def one_view_section(capture: Capture, motion: Motion) -> str:
    """Draw the body from the camera and from the side, and show when the depth of a limb is ambiguous."""
    if not capture.is_one_view or capture.cameras is None or motion.joint_covariance is None:
        return ""
    assert capture.keypoints is not None
    view = int(np.flatnonzero((capture.keypoints.confidence > 0).any(axis=(1, 2)))[0])
    is_open = open_limbs(motion)
    R, t = capture.cameras.poses(view, motion.num_frames)
    centres = -np.einsum("fba,fb->fa", R, t)
    sigma = sight_sigma_m(motion, centres)
    frames = moments(np.nan_to_num(sigma).max(axis=1), MOMENTS)
    drawing = _drawing(motion, centres, frames, is_open)
    rows = [(part, flags.astype(float)) for part, flags in is_open.items()]
    strip = strip_plot(rows, motion.fps)
    body = f"{drawing}<h3>Limbs with ambiguous depth</h3>{strip}"
    return section("From the camera and from the side", body, _LEAD, "side")


def open_limbs(motion: Motion) -> dict[str, np.ndarray]:
    """Return, for each limb, the (F,) mask of frames with an ambiguous depth."""
    found = {part: np.zeros(motion.num_frames, dtype=bool) for part in LIMB_ENDS.values()}
    for item in recorded_diagnostics(motion):
        part = item.values.get("part")
        if item.code in OPEN_CODES and part in found:
            for first, last in item.where.frames:
                found[part][first : last + 1] = True
    return found


def sight_sigma_m(motion: Motion, centres: np.ndarray) -> np.ndarray:
    """Return each joint's (F, J) standard deviation in metres along the line of sight from the camera."""
    assert motion.joint_covariance is not None
    away = motion.joints - centres[:, None]
    sight = away / np.linalg.norm(away, axis=-1, keepdims=True)
    covariance = unpacked(motion.joint_covariance.astype(np.float64))
    return np.sqrt(np.einsum("fja,fjab,fjb->fj", sight, covariance, sight))


def _drawing(motion: Motion, centres: np.ndarray, frames: list[int], is_open: dict[str, np.ndarray]) -> str:
    width, names = WIDTH / len(frames), motion.body_layout.joints
    root = names.index(TRUNK)
    sides = [_axes(motion.joints[frame, root] - centres[frame]) for frame in frames]
    about = [motion.joints[frame] - motion.joints[frame, root] for frame in frames]
    assert motion.joint_covariance is not None
    covariances = [unpacked(motion.joint_covariance[frame].astype(np.float64)) for frame in frames]
    shown = zip(about, covariances, sides, strict=True)
    corners = [_corners(points, covariance, axes) for points, covariance, both in shown for axes in both]
    low, high = np.min([c[0] for c in corners], axis=0), np.max([c[1] for c in corners], axis=0)
    scale = float(min((width - 2 * MARGIN) / (high - low)[0], (ROW - 2 * MARGIN) / (high - low)[1]))
    parts = []
    for column, frame in enumerate(frames):
        for row, (axes, name) in enumerate(zip(sides[column], ("from the camera", "from the side"), strict=True)):
            top, left = CAPTION + row * (ROW + CAPTION), column * width
            view = Projection(axes, (low + high) / 2, np.array([left + width / 2, top + ROW / 2]), scale)
            message = f"frame {frame} · {frame / motion.fps:.2f} s, {name}"
            parts.append(f'<text class="x" x="{left + width / 2:.0f}" y="{top - 6:.0f}">{message}</text>')
            if row == 1:
                floor = view(np.array([0.0, 0.0, -motion.joints[frame, root, 2]]))[1]
                parts.append(draw_line("axis", (left, floor), (left + width, floor)))
            open_now = {part for part, flags in is_open.items() if flags[frame]}
            parts += _person(view, about[column], covariances[column], motion, open_now)
    height = 2 * (ROW + CAPTION)
    return figure("sides", WIDTH, height, parts)


def _axes(sight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sight = sight / np.linalg.norm(sight)
    right = np.cross(sight, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
    return np.stack([right, np.cross(right, sight)]), np.stack([np.cross([0.0, 0.0, 1.0], right), [0.0, 0.0, 1.0]])


def _corners(points: np.ndarray, covariance: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two corners (2,) in metres of the box around projected joints and their confidence ellipses.

    ``points`` (J, 3) are projected onto the two ``axes`` (2, 3).
    """
    flat, reach = points @ axes.T, ELLIPSE * np.sqrt(np.einsum("ka,jab,kb->jk", axes, covariance, axes))
    return (flat - reach).min(axis=0), (flat + reach).max(axis=0)


def _person(
    view: Projection, points: np.ndarray, covariance: np.ndarray, motion: Motion, open_now: set[str]
) -> list[str]:
    names, parts = motion.body_layout.joints, []
    for joint, end in ((names.index(end), end) for end in (TRUNK, *LIMB_ENDS) if end in names):
        kind, name = f"spread {_side(end)}", end.replace("_", " ")
        parts.append(_ellipse(view, points[joint], covariance[joint], kind, name))
    for joint, parent in enumerate(motion.body_layout.parents):
        if parent >= 0:
            kind = f"bone {_side(names[joint])}" + (" open" if _limb_of(names[joint]) in open_now else "")
            parts.append(view.line(kind, points[parent], points[joint]))
    return parts


def _side(joint: str) -> str:
    return {"left": "a", "right": "b"}.get(joint.partition("_")[0], "c")


def _limb_of(joint: str) -> str:
    side, _, part = joint.partition("_")
    limb = {"elbow": "arm", "wrist": "arm", "hand": "arm", "knee": "leg", "ankle": "leg", "foot": "leg"}.get(part)
    return f"{side} {limb}" if limb else ("head" if joint == "head" else "")


HAND_MOMENTS = 3  # Number of frames in which the hands are drawn.
_JOINTS = 3  # Number of joints per finger in a motion.
_FIST_DEG = 180.0  # Flexion of knuckle plus middle joint in a full curl. In a fist, each is 90°.
_SURE_MM, _UNSURE_MM = 3.0, 20.0
"""Standard deviations of finger joints in mm that give a table cell no tint and full tint."""
_SIZE, _SPAN_M = 150.0, 0.24
"""Size of a hand's drawing in drawing units, and of the area it covers in metres. A long hand measures 0.21."""


def hands_section(motion: Motion) -> str:
    """Show how often each finger is visible, its flexion and its curl over time, and draw the hands."""
    names = motion.body_layout.joints
    if not all(f"{side}_{finger}{k + 1}" in names for side in SIDES for finger in FINGERS for k in range(_JOINTS)):
        return ""
    columns = np.array(
        [[[names.index(f"{s}_{f}{k + 1}") for k in range(_JOINTS)] for f in FINGERS] for s in SIDES], dtype=int
    )
    wrists = np.array([names.index(f"{side}_wrist") for side in SIDES])
    seen = np.ones(motion.num_frames)[:, None, None] * np.ones((2, 5))
    if motion.resting is not None:
        seen = 1.0 * ~motion.resting[:, columns].all(axis=-1)
    bends = _bends_deg(motion.joints[:, wrists], motion.joints[:, columns])
    table = _table(motion, columns, seen, bends)
    curl = np.clip(bends.sum(-1) / _FIST_DEG, 0.0, 1.0)
    curls = [(f"{side} {finger}", curl[:, s, f]) for s, side in enumerate(SIDES) for f, finger in enumerate(FINGERS)]
    hidden = 100 * (1 - seen.max(axis=2).mean(axis=0))
    unseen = [f"the {side} hand in {share:.0f} %" for side, share in zip(SIDES, hidden, strict=True) if share > 0]
    lead = "Fingers without data stay relaxed and are flagged. The standard deviations are estimated by the solver."
    if unseen:
        lead += f" No camera sees {' and '.join(unseen)} of frames."
    body = (
        f'<div class="pair">{table}{facts(_rows(motion))}</div><h3>Curl of each finger over time</h3>'
        f"{strip_plot(curls, motion.fps)}<h3>Hands from the back and from the side of the index finger</h3>"
        f"{_pictures(motion, wrists, columns, seen)}"
    )
    return section("Hands", body, lead, "hands")


def _bends_deg(wrists: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return the flexion of knuckles and middle joints in degrees (F frames, 2 hands, 5 fingers, 2 joints)."""
    start = np.broadcast_to(wrists[:, :, None, None], (*joints.shape[:3], 1, 3))
    bones = np.diff(np.concatenate([start, joints], axis=3), axis=3)
    before, after = bones[..., :-1, :], bones[..., 1:, :]
    sine = np.linalg.norm(np.cross(before, after), axis=-1)
    return np.degrees(np.arctan2(sine, (before * after).sum(-1)))


def _table(motion: Motion, columns: np.ndarray, seen: np.ndarray, bends: np.ndarray) -> str:
    rows = [f"{side} {finger}" for side in SIDES for finger in FINGERS]
    known = seen > 0
    share = 100.0 * known.mean(axis=0).reshape(-1)
    sigma = np.full(len(rows), np.nan)
    if motion.joint_sigma is not None:
        spread = 1000.0 * np.where(known, motion.joint_sigma[:, columns].mean(axis=-1), np.nan)
        count = known.sum(axis=0)
        sigma = np.where(count > 0, np.nansum(spread, axis=0) / np.maximum(count, 1), np.nan).reshape(-1)
    middle = bends[..., 1].reshape(len(bends), -1)
    values = np.stack([share, sigma, np.median(middle, axis=0), middle.max(axis=0)], axis=1)
    doubt = np.clip((sigma - _SURE_MM) / (_UNSURE_MM - _SURE_MM), 0.0, 1.0)
    nothing = np.zeros(len(rows))
    strength = np.stack([1.0 - share / 100.0, np.nan_to_num(doubt), nothing, nothing], axis=1)
    heads = ["informed %", "deviation mm", "middle joint, median °", "most °"]
    return heat_table(values, rows, heads, strength=strength, unit="")


def _rows(motion: Motion) -> list[tuple[str, object]]:
    record = motion.provenance.get("hands", {})
    rows: list[tuple[str, object]] = []
    if "size" in record:
        rows.append(("size of the hands", f"{100 * float(record['size']):.0f} % of the size in the body shape"))
    words = {
        "seen_percent": ("measured frames", "{} %"),
        "reprojection_median_px": ("median distance from the detections", "{} px"),
        "residual_median_mm": ("median distance from the markers", "{} mm"),
        "status": ("solve", "{}"),
    }
    for side in SIDES:
        own = record.get(side, {})
        known = {key: value for key, value in own.items() if key in words}
        rows += [(f"{side}: {words[key][0]}", words[key][1].format(value)) for key, value in known.items()]
    gloves = motion.provenance.get("gloves", ())
    rows += [("gloves", f"{item.get('file')} from {item.get('offset_s')} s") for item in gloves]
    return rows


def _pictures(motion: Motion, wrists: np.ndarray, columns: np.ndarray, seen: np.ndarray) -> str:
    """Draw both hands from the back and from the side, in the frames with the most visible fingers."""
    frames = moments(seen.sum(axis=(1, 2)), HAND_MOMENTS)
    drawn = []
    for row, frame in enumerate(frames):
        top = row * (_SIZE + 18)
        drawn.append(f'<text class="x" x="28" y="{top + 12:.0f}">{frame / motion.fps:.2f} s</text>')
        for side in range(len(SIDES)):
            chains = _own_axes(motion.joints[frame, wrists[side]], motion.joints[frame, columns[side]], side)
            for view, across in enumerate((1, 2)):
                left = 60 + (2 * side + view) * _SIZE
                drawn += _hand(chains[..., [0, across]], left, top, "ab"[side], seen[frame, side])
    width, height = 60 + 4 * _SIZE, len(frames) * (_SIZE + 18)
    return figure("space", width, height, drawn)


def _own_axes(wrist: np.ndarray, joints: np.ndarray, side: int) -> np.ndarray:
    """Return finger chains (5, 4, 3) relative to the wrist, in metres and in the axes of the hand.

    The axes point along the palm towards the fingers, across the palm, and out of the back of the hand.
    """
    chains = np.concatenate([np.broadcast_to(wrist, (5, 1, 3)), joints], axis=1) - wrist
    along = _unit(chains[2, 1])
    back = np.cross(chains[4, 1], chains[1, 1]) * (1.0 if side else -1.0)
    back = _unit(back - (back @ along) * along)
    # Seen from the back with its fingers up, a right hand has its thumb on the left.
    return chains @ np.stack([along, np.cross(along, back), back], axis=1)


def _hand(chains: np.ndarray, left: float, top: float, style: str, seen: np.ndarray) -> list[str]:
    """Draw a hand's (5, 4, 2) finger chains as SVG lines. Fingers at rest are faint."""
    scale = _SIZE / _SPAN_M
    parts = []
    for finger, chain in enumerate(chains):
        x, y = left + _SIZE / 2 + scale * chain[:, 1], top + _SIZE - 12 - scale * chain[:, 0]
        way = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
        faint = "" if seen[finger] else ' style="opacity:0.35"'
        parts.append(f'<path class="line bone {style}" d="M{way}"{faint}/>')
        dots = zip(x, y, strict=True)
        parts += [f'<circle class="point" cx="{a:.1f}" cy="{b:.1f}" r="1.6"{faint}/>' for a, b in dots]
    return parts


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
