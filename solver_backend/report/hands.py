"""The page's section about hands: how surely each finger is known, how it bends, and the hands at a few moments."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.hand_points import FINGERS, SIDES
from solver_backend.report.markup import facts, heat_table, section
from solver_backend.report.plots import strip_plot
from solver_backend.types import Motion

MOMENTS = 3
"""Moments at which the hands are drawn."""
_JOINTS = 3
"""Joints of a finger that a motion has."""
_FIST_DEG = 180.0
"""Bend of knuckle and middle joint together that is a whole curl: a fist has 90° each."""
_SURE_MM, _UNSURE_MM = 3.0, 20.0
"""Standard deviations of a finger's joints at which its cell begins to be tinted, and is so wholly."""
_SIZE, _SPAN_M = 150.0, 0.24
"""A hand's picture in the drawing's units, and how many metres it shows: a long hand is 0.21."""


def hands_section(motion: Motion) -> str:
    """Each finger's share of frames that are informed, deviation and bends; curls over time; pictures."""
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
    curls = [
        (f"{side} {finger}", np.clip(bends[:, s, f].sum(-1) / _FIST_DEG, 0.0, 1.0))
        for s, side in enumerate(SIDES) for f, finger in enumerate(FINGERS)
    ]  # fmt: skip
    unseen = [
        f"the {side} hand in {100 * (1 - seen[:, s].max(axis=1).mean()):.0f} %" for s, side in enumerate(SIDES)
        if (seen[:, s].max(axis=1) == 0).any()
    ]  # fmt: skip
    lead = "Fingers that nothing informs rest relaxed and are flagged; joints' deviations are the solver's own."
    if unseen:
        lead += f" Nobody sees {' and '.join(unseen)} of the frames."
    body = (
        f'<div class="pair">{table}{facts(_rows(motion))}</div><h3>Curl of each finger over time</h3>'
        f"{strip_plot(curls, motion.fps)}<h3>Hands from the back and from the side of the index finger</h3>"
        f"{_pictures(motion, wrists, columns, seen)}"
    )
    return section("Hands", body, lead, "hands")


def _bends_deg(wrists: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return (F, 2, 5, 2) degrees by which knuckles and middle joints are bent.

    Args:
        wrists: (F, 2, 3) metres.
        joints: (F, 2, 5, 3, 3).
    """
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
    """Return what the solve recorded of the hands."""
    record = motion.provenance.get("hands", {})
    rows: list[tuple[str, object]] = []
    if "size" in record:
        rows.append(("size of the hands", f"{100 * float(record['size']):.0f} % of what the shape gives"))
    words = {
        "seen_percent": ("frames in which it is measured", "{} %"),
        "reprojection_median_px": ("median distance from the detections", "{} px"),
        "residual_median_mm": ("median distance from the markers", "{} mm"), "status": ("solve", "{}"),
    }  # fmt: skip
    for side in SIDES:
        own = record.get(side, {})
        rows += [
            (f"{side}: {words[key][0]}", words[key][1].format(value)) for key, value in own.items() if key in words
        ]
    gloves = motion.provenance.get("gloves", ())
    rows += [("gloves", f"{item.get('file')} from {item.get('offset_s')} s") for item in gloves]
    return rows


def _pictures(motion: Motion, wrists: np.ndarray, columns: np.ndarray, seen: np.ndarray) -> str:
    """Return both hands at moments at which most of them is known, from their backs and from the side, as SVG."""
    parts = [part for part in np.array_split(np.arange(motion.num_frames), MOMENTS) if len(part)]
    frames = [int(part[seen[part].sum(axis=(1, 2)).argmax()]) for part in parts]
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
    svg = f'<svg viewBox="0 0 {width:g} {height:g}" role="img">{"".join(drawn)}</svg>'
    return f'<figure class="space">{svg}</figure>'


def _own_axes(wrist: np.ndarray, joints: np.ndarray, side: int) -> np.ndarray:
    """Return (5, 4, 3) metres of the fingers' chains, from the wrist: along the palm, across it, out of its back."""
    chains = np.concatenate([np.broadcast_to(wrist, (5, 1, 3)), joints], axis=1) - wrist
    along = _unit(chains[2, 1])
    back = np.cross(chains[4, 1], chains[1, 1]) * (1.0 if side else -1.0)
    back = _unit(back - (back @ along) * along)
    # Seen from its back, fingers up, a right hand has its thumb on the left.
    return chains @ np.stack([along, np.cross(along, back), back], axis=1)


def _hand(chains: np.ndarray, left: float, top: float, style: str, seen: np.ndarray) -> list[str]:
    """Return the lines of a hand's fingers; those that rest are faint.

    Args:
        chains: (5, 4, 2) metres up and to the right.
        left: of the picture.
        top: of the picture.
        style: class of the bones.
        seen: (5,) fingers that something informs.
    """
    scale = _SIZE / _SPAN_M
    parts = []
    for finger, chain in enumerate(chains):
        x, y = left + _SIZE / 2 + scale * chain[:, 1], top + _SIZE - 12 - scale * chain[:, 0]
        way = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
        faint = "" if seen[finger] else ' style="opacity:0.35"'
        parts.append(f'<path class="line bone {style}" d="M{way}"{faint}/>')
        parts += [
            f'<circle class="point" cx="{a:.1f}" cy="{b:.1f}" r="1.6"{faint}/>' for a, b in zip(x, y, strict=True)
        ]
    return parts


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
