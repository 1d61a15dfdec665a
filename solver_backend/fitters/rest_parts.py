"""Put body parts without informative landmarks in a relaxed pose, with the spread found in people.

No measurement depends on the rotations of such parts. With the conditional prior ``p(part | seen) = N(rest(seen), Σ)``,
the posterior factorises: observed joints keep the optimum of the fit, the part gets its rest pose, and its covariance
is the spread in recordings. A prior within the fit would also move observed joints, because the marker on a shoulder
moves with the arm. For a raised arm without other markers (UI-PRMD m06_s04_e05), a prior of 0.3 rad moves the shoulder
by 36 mm instead of 8. Markers that move with a resting part are compared with the pose before the part was put at rest.
``offsets`` are the landmarks' (L, 3) offsets in the rest pose in metres. ``located`` (F, L) marks the known landmarks.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import forward_kinematics, subtree_matrix
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.markers import ON_BONE
from solver_backend.body.resting_posture import PARTS, rest_rotations
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.fitters.problem import Measurements, RestWords, SolvedFrames
from solver_backend.geometry.arrays import Array, constant, to_numpy, true_runs
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.geometry.small_matrices import packed, unpacked

ANCHORS = {
    "trunk": "pelvis", "head": "spine3", "left_upper_arm": "spine3", "right_upper_arm": "spine3",
    "left_thigh": "pelvis", "right_thigh": "pelvis", "left_forearm": "left_shoulder",
    "right_forearm": "right_shoulder", "left_shank": "left_hip", "right_shank": "right_hip",
}  # fmt: skip
"""Last known joint above each part. In reverse order, lower parts come first."""
SPREAD_MM: dict[str, dict[str, tuple[float, float, float]]] = {
    "pelvis": {
        "spine2": (9, 20, 36), "spine3": (12, 30, 45), "neck": (24, 41, 72), "head": (26, 70, 85),
        "collar": (22, 39, 62), "shoulder": (26, 28, 66), "elbow": (113, 362, 119), "wrist": (132, 522, 234),
        "hand": (152, 554, 298), "knee": (44, 131, 69), "ankle": (38, 211, 161), "foot": (42, 250, 252),
    },
    "spine3": {"head": (7, 38, 10), "elbow": (140, 252, 84), "wrist": (281, 411, 131), "hand": (145, 590, 199)},
    "shoulder": {"wrist": (130, 222, 88), "hand": (396, 108, 235)},
    "hip": {"ankle": (13, 398, 81), "foot": (13, 352, 166)},
}  # fmt: skip
"""Standard deviations in mm along the anchor bone's axes (left, up and front at rest) for a person with an upright
pelvis, keyed by anchor (without side). Fitted with ``python -m tests.benchmarks.resting_spread`` to recordings from
CMU, UI-PRMD and running laboratories, so that ellipsoids contain about 50, 80 and 95 %. Trunk and head have 1.2 to 2.5
times these values, because without their markers the pelvis leans by 8 degrees."""
BESIDE_MM: dict[str, dict[str, float]] = {
    "trunk": {"pelvis": 7.0, "hip": 9.5, "spine1": 20.0}, "thigh": {"pelvis": 6.5, "hip": 9.5},
}  # fmt: skip
"""Additional deviation per axis in mm of joints next to a resting part, keyed by part (without side). The part's
markers would have shown the lean of the pelvis and the person's size. Two resting thighs both count."""
TILT_DEG, MOST_DEG = 15.0, 60.0
"""Lean of the pelvis in degrees that doubles the spread of trunk, head and legs, and largest lean that counts, because
people who sit or kneel vary more."""
ARM_TILT_DEG, ARM_MOST_DEG = 100.0, 45.0
"""The same two values for arms, for leans beyond ``TILT_DEG``. Without them, ellipsoids would be 1.1, 1.3 and 1.5 times
too small at 25, 40 and 60 degrees."""
SLOW_M_S, FAST_M_S, WINDOW_S = 0.3, 0.8, 0.5
"""Largest ground speed of a stationary pelvis, smallest walking speed (both in m/s), and averaging time in s."""
WALKING = {"arm": 0.62, "upper": 0.75}
"""Spread of walkers' arms, and of head and shoulders above an observed pelvis, relative to other people's. Radii that
contain 50, 80 and 95 % of CMU's walks are 0.47, 0.66 and 0.81 times as large for arms, and 0.74, 0.73 and 0.75 for the
upper body."""
LOW_M, LOWEST_M, LOW = 0.03, 0.14, 1.35
"""Pelvis drops (m) between which the legs' spread grows, and the largest factor of this growth (CMU: 1.2 to 1.4)."""
_ARM, _LEG, _UPPER = ("elbow", "wrist", "hand"), ("knee", "ankle", "foot"), ("neck", "head", "collar", "shoulder")


@dataclass(frozen=True)
class Stance:
    """Posture of a person over F frames, derived from the pelvis: lean, walking and height. All arrays are (F,)."""

    lean: np.ndarray  # Degrees between the pelvis axis and the vertical.
    walking: np.ndarray  # From 0 (in place) to 1 (walking).
    low: np.ndarray  # From 0 (standing) to 1 (sitting, squatting, kneeling or lying).


def stance(rotations: np.ndarray, places: np.ndarray, fps: float) -> Stance:
    """Derive the posture from a pelvis: rotations (F, 3, 3), and positions (F, 3) in metres."""
    lean = np.degrees(np.arccos(np.clip(rotations[:, 2, 1], -1.0, 1.0)))
    half, every = max(1, round(0.5 * WINDOW_S * fps)), np.arange(len(places))
    first, last = np.maximum(every - half, 0), np.minimum(every + half, len(places) - 1)
    speed = np.linalg.norm(places[last, :2] - places[first, :2], axis=-1) * fps / np.maximum(last - first, 1)
    drop = float(np.quantile(places[:, 2], 0.95)) - places[:, 2]
    walking, low = (speed - SLOW_M_S) / (FAST_M_S - SLOW_M_S), (drop - LOW_M) / (LOWEST_M - LOW_M)
    return Stance(lean, np.clip(walking, 0.0, 1.0), np.clip(low, 0.0, 1.0))


def with_resting_spread(
    covariance: np.ndarray,
    rotations: np.ndarray,
    shown: Stance,
    layout: BodyLayout,
    below: dict[str, tuple[str, ...]],
    shares: dict[str, np.ndarray],
) -> np.ndarray:
    """Return covariances (F, J, 6) that include the spread of resting parts: ``(1 - s) C + s (C_anchor + k² G D² Gᵀ)``.

    C_anchor and G are the covariance and the rotation of the part's anchor joint (``ANCHORS``). k is ``growth``, and D
    are the deviations in ``SPREAD_MM``. A resting part also affects the joints in ``BESIDE_MM``. The square of their
    deviation, multiplied by s, is added to their variances.

    Args:
        covariance: (F, J, 6) covariances C of the fit in m² (see ``packed``).
        rotations: (F, J, 3, 3) global joint rotations.
        shown: stance of the person.
        below: joints that each part's rotations move.
        shares: (F,) weight s of each part's rest pose.
    """
    found = unpacked(covariance)
    for part in reversed(ANCHORS):
        if part not in shares:
            continue
        anchor = layout.joints.index(ANCHORS[part])
        G, table = rotations[:, anchor], SPREAD_MM[_bare(ANCHORS[part])]
        share = shares[part][:, None, None]
        for name in below[part]:
            if _bare(name) in table:  # a body may have joints that no recording shows
                variance = (1e-3 * np.array(table[_bare(name)])) ** 2
                k = growth(shown, _bare(ANCHORS[part]), _bare(name))[:, None, None]
                own = k**2 * ((G * variance) @ np.swapaxes(G, -1, -2))
                j = layout.joints.index(name)
                found[:, j] += share * (found[:, anchor] + own - found[:, j])
    for part, share in shares.items():
        beside = BESIDE_MM.get(_bare(part), {})
        for j, name in enumerate(layout.joints):
            if _bare(name) in beside:
                found[:, j] += share[:, None, None] * (1e-3 * beside[_bare(name)]) ** 2 * np.eye(3)
    return packed(found)


def growth(shown: Stance, anchor: str, joint: str) -> np.ndarray:
    """Return the factor (F,) by which a posture widens a joint's spread around its anchor, relative to standing.

    The factor is ``1 + min(θ, MOST_DEG) / TILT_DEG`` for trunk, head and legs,
    ``1 + clip(θ - TILT_DEG, 0, ARM_MOST_DEG) / ARM_TILT_DEG`` for arms, and 1 for a head on an observed chest. θ is the
    lean of the pelvis. ``WALKING`` is an additional factor for the upper body of a walker, and ``LOW`` for the legs of
    a person near the floor.
    """
    if joint in _ARM:
        leaning = 1.0 + np.clip(shown.lean - TILT_DEG, 0.0, ARM_MOST_DEG) / ARM_TILT_DEG
        return leaning * (1.0 + (WALKING["arm"] - 1.0) * shown.walking)
    if anchor not in ("pelvis", "hip"):
        return np.ones_like(shown.lean)
    leaning = 1.0 + np.minimum(shown.lean, MOST_DEG) / TILT_DEG
    if joint in _LEG:
        return leaning * (1.0 + (LOW - 1.0) * shown.low)
    return leaning * (1.0 + (WALKING["upper"] - 1.0) * shown.walking) if joint in _UPPER else leaning


def _bare(name: str) -> str:
    return name.removeprefix("left_").removeprefix("right_")


CORE = ("pelvis", "spine1", "spine2", "spine3", "neck", "head")  # A measurement of one of these locates the body.
NEAR_M, NEAR_HIP_M = 0.13, 0.17
"""Largest distance of a landmark from a joint that it measures. The pelvis markers are 114 mm from the pelvis joint and
150 mm from the hips. The acromion marker is 153 mm from the neck. A wand 230 mm from the hip does not measure it."""
LONG_M = 0.2  # Shortest bone of a limb. Bones of the trunk and the feet are shorter.
BEYOND_CHEST_RAD, BEYOND_LIMBS_RAD, BEYOND_LIMB_RAD = 0.15, 0.25, 0.60
"""Standard deviation per axis, in metres, of an assumed joint per metre from the nearest landmark: with a measured
trunk or head, with two measured limbs, and with one. In six takes from CMU and UI-PRMD, the pelvis has RMS errors per
axis of 33 mm below a chest, 85 above legs, 90 between arms, 155 above one leg and 290 below one arm."""
_LEG_JOINTS = ("hip", "knee", "ankle", "foot")
_SHOWN = "pelvis pelvis, hip hips, knee knees, spine trunk, collar shoulders, shoulder shoulders, neck head, head head"
_WORDS = dict[str, str](map(str.split, _SHOWN.split(", ")))


def assumed_joints(body: Body, landmarks: Landmarks, offsets: np.ndarray, located: np.ndarray) -> dict[str, float]:
    """Return the deviations in metres of joints that no landmark measures, by name.

    A joint is measured if a landmark is near it, or if it is between measured joints of one limb. If a joint in
    ``CORE`` is measured, joints between any two measured joints are also measured. Two knees do not determine thighs.
    An arm without a trunk does not determine its shoulder, because the acromion marker may be on either side of the
    joint.
    """
    names, ever = body.layout.joints, located.any(axis=0)
    if not ever.any():
        return {}
    anchors, joints = landmarks.anchors.sum(axis=1), body.joints_template[:, None]
    away = np.linalg.norm(joints - (anchors + offsets)[ever], axis=-1).min(axis=1)
    named = ever & np.array([not name.startswith(ON_BONE) for name in landmarks.names])
    if named.any():  # named locations do not depend on the size of the person
        away = np.minimum(away, np.linalg.norm(joints - anchors[named], axis=-1).min(axis=1))
    near = {j for j, name in enumerate(names) if away[j] < (NEAR_HIP_M if name.endswith("hip") else NEAR_M)}
    core = any(names[j] in CORE for j in near)
    if not core:
        near -= {j for j in near if away[j] > 0.0 and names[j].endswith(("collar", "shoulder"))}
    parents = body.parents
    between = _between(near, parents, across=core)
    folding = _folding(between - near, body)
    limbs = {(names[j].split("_")[0], names[j].endswith(_LEG_JOINTS)) for j in near}
    share = BEYOND_CHEST_RAD if core else BEYOND_LIMBS_RAD if len(limbs) > 1 else BEYOND_LIMB_RAD
    known = between - folding
    for j, parent in enumerate(parents):
        known |= {j} if parent in known and j not in folding else set()
    return {name: share * float(away[j]) for j, name in enumerate(names) if j not in known}


def with_assumed_spread(covariance: np.ndarray, layout: BodyLayout, assumed: Mapping[str, float]) -> np.ndarray:
    """Add the variance ``σ² I`` of unmeasured joints to the covariances (F, J, 6) in m²."""
    found = unpacked(covariance)
    for name, sigma in assumed.items():
        if name in layout.joints:
            found[:, layout.joints.index(name)] += sigma**2 * np.eye(3)
    return packed(found)


def assumed_places(assumed: Mapping[str, float], at_rest: Collection[str]) -> tuple[str, float]:
    """Return a list, as text, of the unmeasured joints that are not at rest, and their largest deviation in m."""
    kept = {name: sigma for name, sigma in assumed.items() if name not in at_rest}
    words = list(dict.fromkeys(word for name in kept if (word := _WORDS.get(name.split("_")[-1].rstrip("123")))))
    return joined_words(words), max(kept.values(), default=0)


def joined_words(words: Sequence[str]) -> str:
    """Join names into a list for a sentence, such as "arms, trunk and head"."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)


def _between(near: Collection[int], parents: Sequence[int], *, across: bool) -> set[int]:
    lines = {j: _line(j, parents) for j in near}
    found = set(near)
    for line in lines.values():
        above = [k for k, a in enumerate(line) if k and a in near]
        found |= set(line[: above[-1]]) if above else set()
    if across and near:
        shared = set.intersection(*map(set, lines.values()))
        top = max(shared, key=lambda j: len(_line(j, parents)))
        found |= {a for line in lines.values() for a in line[: line.index(top) + 1]}
    return found


def _folding(unmarked: Collection[int], body: Body) -> set[int]:
    """Return the joints of chains that have no landmarks but contain a whole long bone.

    Such a chain can fold, so its ends do not determine it: a head and heels show neither knees nor a pelvis.
    """
    lengths = np.linalg.norm(body.joints_template - body.joints_template[np.maximum(body.parents, 0)], axis=-1)
    group, long = dict[int, int](), set[int]()
    for j in sorted(unmarked):
        group[j] = group.get(parent := int(body.parents[j]), j)
        if parent in group and lengths[j] > LONG_M:
            long.add(group[j])
    return {j for j, first in group.items() if first in long}


def _line(j: int, parents: Sequence[int]) -> list[int]:
    line = [j]
    while parents[line[-1]] >= 0:
        line.append(int(parents[line[-1]]))
    return line


LEADS: dict[str, tuple[str, float]] = {
    "trunk": ("spine1", 0.08),
    "head": ("neck", 0.06),
    **{
        f"{side}_{part}": (f"{side}_{joint}", 0.06)
        for part, joint in (("upper_arm", "shoulder"), ("forearm", "elbow"), ("thigh", "hip"), ("shank", "knee"))
        for side in ("left", "right")
    },
}
"""Joint that poses each part in ``PARTS``, and smallest lever in metres of a landmark that determines it. The waist
markers have 53 mm about the lowest spine joint, C7 has 31 mm about the neck, and the acromion 34 mm about the shoulder.
"""
HOLD_S, FADE_S = 0.5, 0.5  # Seconds that an undetermined part follows the fit, and seconds of its transition to rest.
UNKNOWN_S = 0.5
"""Seconds after a part's landmarks disappear in which its deviation rises to the resting deviation. Arms have errors of
29 to 242 mm after 0.5 s without markers (CMU, UI-PRMD), but the fit states 14 to 26 mm. The fit is still better
than the rest pose."""


BETWEEN = 0.4
"""Largest weight of the resting variance in interpolated gaps. In gaps of 0.5 and 1 s (CMU 02_01, 135_02), joints have
errors of 40 to 175 mm per axis, but the fit states 8 to 22. In a gap of 0.1 s, the cubic weight is 3 %."""


@dataclass(frozen=True)
class PartShares:
    """Weights (F,) from 0 to 1 for each part that is undetermined in some frame."""

    rest: dict[str, np.ndarray]  # Weight of the rest pose.
    spread: dict[str, np.ndarray]  # Smallest weight of the resting variance.


def resting_shares(
    body: Body,
    landmarks: Landmarks,
    offsets: np.ndarray,
    located: np.ndarray,
    seen: np.ndarray,
    fps: float,
    pinned: Sequence[int] = (),
) -> PartShares:
    """Return the weights of the rest pose and of the resting variance for undetermined parts.

    A landmark determines a part if its lever about the part's first joint is at least the lever in ``LEADS``.
    ``pinned`` frames determine every part. All other weights depend on the time to the nearest frame that determines
    the part. The weight of the rest pose is ``3 u² - 2 u³``, where u rises from 0 to 1 within ``FADE_S``, beginning
    after ``HOLD_S``. The weight of the variance rises within ``UNKNOWN_S``. Before the first and after the last frame
    that determines the part, it rises with the square of time. Between two frames that determine the part, it rises
    with the third power of time, up to ``BETWEEN``. The weight of the variance is never less than the weight of the
    rest pose. Frames outside ``seen`` (F,) do not place the body and are interpolated.
    """
    known = np.isin(np.arange(len(seen)), list(pinned))
    frames, every, found = np.flatnonzero(seen | known), np.arange(len(seen)), PartShares({}, {})
    if not len(frames):
        return found
    lever = levers(body, landmarks, offsets)
    for part, (joint, least) in LEADS.items():
        if not {joint, ANCHORS[part]} <= set(body.layout.joints):
            continue
        leads = lever[:, body.layout.joints.index(joint)] >= least
        informed = located[np.ix_(frames, leads)].any(axis=1) | known[frames]
        away, between = _distance(frames, frames[informed])
        u, gone = np.clip((away / fps - HOLD_S) / FADE_S, 0.0, 1.0), np.minimum(away / fps / UNKNOWN_S, 1.0)
        rest, unknown = u * u * (3.0 - 2.0 * u), np.where(between, np.minimum(gone**3, BETWEEN), gone**2)
        if rest.any():
            found.rest[part] = np.interp(every, frames, rest)
        if rest.any() or unknown.any():
            found.spread[part] = np.interp(every, frames, np.maximum(rest, unknown))
    return found


def uninformed_parts(body: Body, measurements: Measurements) -> tuple[str, ...]:
    """Return the parts whose pose the measurements never determine, assuming landmarks without offsets."""
    return parts_without(body, measurements.landmarks, measurements.located.any(axis=0))


def parts_without(body: Body, landmarks: Landmarks, located: np.ndarray) -> tuple[str, ...]:
    """Return the parts whose pose no located landmark determines."""
    once, offsets = np.ones(1, dtype=bool), np.zeros((len(landmarks), 3))
    return tuple(resting_shares(body, landmarks, offsets, located[None], once, 1.0).rest)


def levers(body: Body, landmarks: Landmarks, offsets: np.ndarray) -> np.ndarray:
    """Return distances (L, J) in metres that landmarks at rest move per radian at each joint."""
    below = subtree_matrix(body.parents)
    share = landmarks.weights @ below.T
    places = np.einsum("jb,lbi->lji", below, landmarks.anchors) + share[..., None] * offsets[:, None]
    return np.linalg.norm(places - share[..., None] * body.joints_template, axis=-1)


def _distance(frames: np.ndarray, informed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not len(informed):
        return np.full(len(frames), np.inf), np.zeros(len(frames), dtype=bool)
    after = np.searchsorted(informed, frames)
    left, right = informed[np.maximum(after - 1, 0)], informed[np.minimum(after, len(informed) - 1)]
    away = np.minimum(np.abs(frames - left), np.abs(frames - right)).astype(np.float64)
    return away, (frames >= informed[0]) & (frames <= informed[-1])


_NAMES = {"upper_arm": "upper arm", "forearm": "forearm", "thigh": "thigh", "shank": "lower leg"}


def rest_parts(measurements: Measurements, solved: SolvedFrames, pinned: Sequence[int] = ()) -> SolvedFrames:
    """Put undetermined parts at rest. Return the same object if all parts are determined.

    ``pinned`` are frames with a pose that the user set.
    """
    subject, frames = solved.subject, solved.frames
    body, layout = subject.body, subject.body.layout.recorded
    offsets, seen = to_numpy(subject.offsets), measurements.seen
    parts = resting_shares(body, subject.landmarks, offsets, measurements.located, seen, measurements.fps, pinned)
    shares, spread = parts.rest, parts.spread
    assumed = {} if len(pinned) else assumed_joints(body, subject.landmarks, offsets, measurements.located)
    if not spread and not assumed:
        return solved
    below = {part: _below(layout, part) for part in spread}
    if not shares and not assumed:  # every part is determined, though some not to the take's ends
        return replace(solved, covariance=_spread_out(solved, measurements.fps, layout, below, spread))
    where, sigma_m = assumed_places(assumed, {name for part in shares for name in below[part]})
    local = to_numpy(frames.local)
    local = _rested(body, to_numpy(frames.root), local, shares) if shares else local
    fitted, frames = frames, replace(frames, local=constant(local, frames.local))
    resting = np.zeros((len(local), layout.num_joints))
    for part, share in shares.items():
        columns = [layout.joints.index(name) for name in below[part]]
        resting[:, columns] = np.maximum(resting[:, columns], share[:, None])
    resting[:, [j for j, name in enumerate(layout.joints) if name in assumed]] = 1.0
    covariance, contacts = solved.covariance, solved.contacts
    if covariance is not None:
        covariance = constant(with_assumed_spread(to_numpy(covariance), layout, assumed), covariance)
    known = replace(solved, frames=frames, covariance=covariance)
    covariance = _spread_out(known, measurements.fps, layout, below, spread)
    if contacts is not None:
        feet = [layout.joints.index(f"{side}_foot") for side in ("left", "right")]
        contacts = contacts & (resting[:, feet] == 0.0)
    found = [*solved.diagnostics, *_diagnose(shares, measurements.source.REST)]
    if where:
        found.append(diagnostic("place_assumed", part=where, mm=1000 * sigma_m))
    return replace(
        solved,
        frames=frames,
        covariance=covariance,
        contacts=contacts,
        fitted=fitted,
        resting=resting > 0.0,
        diagnostics=tuple(found),
    )


def _spread_out(
    solved: SolvedFrames,
    fps: float,
    layout: BodyLayout,
    below: dict[str, tuple[str, ...]],
    shares: dict[str, np.ndarray],
) -> Array | None:
    if solved.covariance is None:
        return None
    body, frames = solved.subject.body, solved.frames
    posed = forward_kinematics(body, solved.subject.betas, frames.root, frames.local, frames.transl)
    G, pelvis = to_numpy(posed.G), to_numpy(posed.joints)[:, 0]
    recorded, shown = G[:, list(body.recorded_joints)], stance(G[:, 0], pelvis, fps)
    spread = with_resting_spread(to_numpy(solved.covariance), recorded, shown, layout, below, shares)
    return constant(spread, solved.covariance)


def _rested(body: Body, root: np.ndarray, local: np.ndarray, shares: dict[str, np.ndarray]) -> np.ndarray:
    frames = np.flatnonzero(np.any([share > 0.0 for share in shares.values()], axis=0))
    fitted, joints, found = local[frames].astype(np.float64), body.layout.joints, local.copy()
    # From the trunk outwards, because arms and head hang from a trunk that is already at rest.
    for part in (part for part in PARTS if part in shares):
        share = shares[part][frames, None]
        rest = rest_rotations(body, root[frames].astype(np.float64), fitted, (part,))
        for j in (joints.index(name) - 1 for name in PARTS[part] if name in joints):
            between = log_so3(rest[:, j] @ np.swapaxes(fitted[:, j], -1, -2))
            fitted[:, j] = np.where(share[..., None] > 0.0, exp_so3(share * between) @ fitted[:, j], fitted[:, j])
    found[frames] = fitted
    return found


def _below(layout: BodyLayout, part: str) -> tuple[str, ...]:
    moved, turned = set(), {layout.joints.index(name) for name in PARTS[part] if name in layout.joints}
    for j, parent in enumerate(layout.parents):
        if parent in turned or parent in moved:
            moved.add(j)
    return tuple(layout.joints[j] for j in sorted(moved))


def _diagnose(shares: dict[str, np.ndarray], words: RestWords) -> Iterator[Diagnostic]:
    by_runs: dict[tuple[tuple[int, int], ...], list[str]] = {}
    for part, share in shares.items():
        by_runs.setdefault(tuple(true_runs(share > 0.0)), []).append(part)
    for runs, parts in by_runs.items():
        runs = () if runs == ((0, len(shares[parts[0]]) - 1),) else runs
        subject = listed(parts)
        lack = words.several if " and " in subject or subject.endswith("s") else words.one
        yield diagnostic("parts_at_rest", severity=words.severity, frames=runs, part=f"{subject} {lack}")


def listed(parts: list[str]) -> str:
    """Join the names of body parts into a phrase for a message, such as "Arms and head"."""
    words = []
    for limb, halves in (("arm", ("upper_arm", "forearm")), ("leg", ("thigh", "shank"))):
        sides = {side: [half for half in halves if f"{side}_{half}" in parts] for side in ("left", "right")}
        if sides["left"] == sides["right"] and sides["left"]:
            words += [_NAMES[half] + "s" for half in sides["left"]] if len(sides["left"]) == 1 else [limb + "s"]
            continue
        for side, found in sides.items():
            words += [f"{side} {limb}"] if len(found) == 2 else [f"{side} {_NAMES[half]}" for half in found]
    words += [part for part in ("trunk", "head") if part in parts]
    text = joined_words(words)
    return text[:1].upper() + text[1:]
