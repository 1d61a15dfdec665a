"""What no landmark informs is laid at rest after a fit: the seen joints keep what was measured, bit for bit.

Nothing measured depends on the turns of such parts. With the conditional prior ``p(part | seen) = N(rest(seen), Σ)``
the posterior factors: the optimum of the seen joints is the fit's, that of the part its rest, and its covariance is the
spread that recordings show. A pull inside the fit drags seen joints along: the marker on a shoulder moves with the arm,
and where a raised arm has no markers of its own (UI-PRMD m06_s04_e05) a pull of 0.3 rad puts the shoulder 36 mm off
instead of 8. Such markers are compared with the pose before the rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import forward_kinematics, subtree_matrix
from solver_backend.body.landmark_set import Landmarks
from solver_backend.body.resting_posture import PARTS, rest_rotations
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.fitters.layers import Measurements, RestWords
from solver_backend.fitters.partial_body.resting_spread import (
    ANCHORS,
    assumed_joints,
    assumed_places,
    joined_words,
    stance,
    with_assumed_spread,
    with_resting_spread,
)
from solver_backend.fitters.problem import SolvedFrames
from solver_backend.geometry.arrays import Array, constant, to_numpy, true_runs
from solver_backend.geometry.rotations import exp_so3, log_so3

LEADS: dict[str, tuple[str, float]] = {
    "trunk": ("spine1", 0.08),
    "head": ("neck", 0.06),
    **{
        f"{side}_{part}": (f"{side}_{joint}", 0.06)
        for part, joint in (("upper_arm", "shoulder"), ("forearm", "elbow"), ("thigh", "hip"), ("shank", "knee"))
        for side in ("left", "right")
    },
}
"""The joint that poses each part of ``PARTS``, and the least lever in metres of a landmark that informs it. The waist's
markers have levers of 53 mm about the lowest joint of the spine and T12 131; C7 has 31 about the neck, the acromion 34
about the shoulder, the elbow's 31 about the elbow, and the tibia's tuberosity 74 about the knee."""
HOLD_S, FADE_S = 0.5, 0.5
"""Seconds for which a part follows the fit after it was last informed (and before it is again), and in which it then
comes to rest. Gaps of up to a second are interpolated."""
UNKNOWN_S = 0.5
"""Seconds before the first and after the last informed frame in which a part's deviation rises to that at rest: nothing
leads back from there, and the fit states 14 to 26 mm of arms that are 29 to 242 mm off in the last 0.25 and 0.5 s
without markers (CMU 02_01 and 135_02, five exercises of UI-PRMD). Its pose follows the fit, which is nearer than a
rest: 38 to 90 mm against 197 to 293 in 0.5 s of three exercises."""


BETWEEN = 0.4
"""Largest share of the resting variance while a part is interpolated between informed frames. In gaps of 0.5 and 1 s of
arms and legs (CMU 02_01, 135_02) joints are 40 to 175 mm off per axis where the fit states 8 to 22; in one of 0.1 s the
third power leaves 3 % of the deviation at rest."""


@dataclass(frozen=True)
class PartShares:
    """Shares (F,), from 0 to 1, of each part that is uninformed anywhere."""

    rest: dict[str, np.ndarray]  # Share of the rest in the pose.
    spread: dict[str, np.ndarray]  # Least share of the resting variance.


def resting_shares(
    body: Body,
    landmarks: Landmarks,
    offsets: np.ndarray,
    located: np.ndarray,
    seen: np.ndarray,
    fps: float,
    pinned: Sequence[int] = (),
) -> PartShares:
    """Return the shares of rest and of resting variance of each part that is not informed throughout.

    A landmark informs a part where it moves by ``LEADS``' lever when the part's first joint turns. The rest rises as
    ``3 u² - 2 u³`` while u, the time since ``HOLD_S`` after the part was informed over ``FADE_S``, rises from 0 to 1.
    Before the first and after the last informed frame the variance rises with the time over ``UNKNOWN_S``, squared, and
    between informed frames with its third power up to ``BETWEEN``.

    Args:
        seen: (F,) bool: enough is located to place the body. Between such frames shares lie on straight lines.
        pinned: frames with pinned poses, which informs every part.
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
    """Return the parts that are informed in no frame, by landmarks without offsets."""
    return parts_without(body, measurements.landmarks, measurements.located.any(axis=0))


def parts_without(body: Body, landmarks: Landmarks, located: np.ndarray) -> tuple[str, ...]:
    """Return the parts that none of the located landmarks, (L,) bool without offsets, informs."""
    once, offsets = np.ones(1, dtype=bool), np.zeros((len(landmarks), 3))
    return tuple(resting_shares(body, landmarks, offsets, located[None], once, 1.0).rest)


def levers(body: Body, landmarks: Landmarks, offsets: np.ndarray) -> np.ndarray:
    """Return (L, J) movements of landmarks at rest by the turn of each joint, metres per radian about a far axis."""
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
    """Return the poses with the uninformed parts at rest, or the same object where there are none.

    ``pinned`` are frames with pinned poses.
    """
    subject, frames = solved.subject, solved.frames
    body, layout = subject.body, subject.body.layout.recorded
    offsets, seen = to_numpy(subject.offsets), measurements.seen
    parts = resting_shares(body, subject.landmarks, offsets, measurements.located, seen, measurements.fps, pinned)
    shares, spread = parts.rest, parts.spread
    if not spread:
        return solved
    below = {part: _below(layout, part) for part in spread}
    if not shares:  # every part is informed, some of them not to the take's ends
        return replace(solved, covariance=_spread_out(solved, measurements.fps, layout, below, spread))
    assumed = {} if len(pinned) else assumed_joints(body, subject.landmarks, offsets, measurements.located)
    where, sigma_m = assumed_places(assumed, {name for part in shares for name in below[part]})
    local = _rested(body, to_numpy(frames.root), to_numpy(frames.local), shares)
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
    # From the trunk outwards: what hangs is hung on a trunk that rests already.
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
    """Return the words for parts of ``PARTS``, with sides and halves of a limb joined: "Arms and head"."""
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
