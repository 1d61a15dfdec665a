"""Write the sections about ISB joint angles, their standard deviations, and gait."""

from __future__ import annotations

import numpy as np

from solver_backend.biomechanics.gait import MEASURES, SIDES, Gait, find_gait
from solver_backend.biomechanics.joint_angles import Angles, isb_angles
from solver_backend.biomechanics.open_sim import virtual_markers
from solver_backend.biomechanics.segments import posed_segments, turn_covariances, without_fingers
from solver_backend.biomechanics.support import JUMP_S, find_support
from solver_backend.body.body import Body, load_body
from solver_backend.exchange.body_layout import SMPL
from solver_backend.report.markup import facts, number, section, text
from solver_backend.types import Motion

_LEAD = (
    "The table shows the minimum, mean and maximum joint angles in degrees, defined as the ISB recommends (Wu et "
    "al. 2002 and 2005). The deviation is the median standard deviation from the pose's posterior covariance. It "
    "excludes differences between definitions. <code>motion export</code> writes the angles of every frame."
)


def biomechanics_sections(motion: Motion) -> str:
    """Write the sections about joint angles and gait. Return "" for any body except the neutral SMPL body."""
    body = load_body()
    motion = without_fingers(motion, body)
    if motion.body != body.id or motion.body_layout != SMPL:
        return ""
    posed = posed_segments(motion, body)
    angles = isb_angles(posed, turn_covariances(motion))
    gait = find_gait(posed, virtual_markers(motion, body, posed), motion.flags)
    found = section("ISB joint angles", _angle_table(angles), _LEAD, "isb")
    found += section("Gait", _gait_table(gait), identifier="gait") if gait.strides else ""
    return found + _support_section(motion, body)


def _support_section(motion: Motion, body: Body) -> str:
    """Write the section about floor contacts and balance, if the motion is on the floor z = 0."""
    if (support := find_support(motion, body)) is None:
        return ""
    shares = {part: 100.0 * float((chance > 0.5).mean()) for part, chance in support.probability.items()}
    rows: list[tuple[str, object]] = [
        (f"{part} on the floor", f"{v:.0f} % of the frames") for part, v in shares.items() if v
    ]
    deep = ", ".join(f"{1000 * float(np.quantile(support.depth_m, q)):.0f} mm" for q in (0.5, 0.95, 1.0))
    rows.append(("skin below the floor (median, 95 %, largest)", deep))
    known = support.margin_m[np.isfinite(support.margin_m)]
    if len(known):
        rows.append(
            ("centre of mass above support area", f"{100 * float((known > 0).mean()):.0f} % of the frames with contact")
        )
    rows.append(("longest time above the floor", f"{support.longest_flight_s:.2f} s"))
    lead = (
        "Contacts are detected from the height and speed of the skin above the floor. The centre of mass assumes "
        "uniform body density. If it is outside the support area, the person is moving or leaning on something."
    )
    if support.is_floating:
        lead += f" No jump lasts longer than {JUMP_S:g} s, so the person may be on something, or heights may be wrong."
    return section("Contacts and balance", facts(rows), lead, "balance")


def _angle_table(angles: Angles) -> str:
    bare = dict.fromkeys(name.removeprefix("left_").removeprefix("right_") for name in angles.names)
    rows = []
    for name in bare:
        cells = "".join(_cells(angles, name if name in angles.names else f"{side}_{name}") for side in SIDES)
        rows.append(f"<tr><th>{text(name.replace('_', ' '))}</th>{cells}</tr>")
    head = "".join(f"<th>{side}</th><th>deviation</th>" for side in SIDES)
    return f'<table class="facts"><tr><th></th>{head}</tr>{"".join(rows)}</table>'


def _cells(angles: Angles, name: str) -> str:
    k = angles.names.index(name)
    curve, spread = angles.degrees[:, k], np.nan
    if angles.deviations is not None and np.isfinite(angles.deviations[:, k]).any():
        spread = float(np.nanmedian(angles.deviations[:, k]))
    span = " / ".join(number(float(value), 0) for value in (curve.min(), curve.mean(), curve.max()))
    return f"<td>{span}</td><td>{number(spread)}</td>"


def _gait_table(gait: Gait) -> str:
    rows = []
    for key, word in MEASURES.items():
        cells = ""
        for side in SIDES:
            values = [getattr(stride, key) for stride in gait.strides if stride.side == side]
            values = [value for value in values if np.isfinite(value)]
            mean = number(float(np.mean(values)), 2) if values else "–"
            cells += f"<td>{mean}{f' ± {np.std(values, ddof=1):.2f}' if len(values) > 1 else ''}</td>"
        rows.append(f"<tr><th>{text(word)}</th>{cells}</tr>")
    counts = "".join(f"<th>{side}, {sum(s.side == side for s in gait.strides)} strides</th>" for side in SIDES)
    return f'<table class="facts"><tr><th></th>{counts}</tr>{"".join(rows)}</table>'
