"""What no landmark informs is laid at rest after a fit: the seen joints keep what was measured, bit for bit.

Nothing measured depends on the turns of such parts. With the conditional prior ``p(part | seen) = N(rest(seen), Σ)``
the posterior factors: the optimum of the seen joints is the fit's, that of the part its rest, and its covariance is the
spread that recordings show. A pull inside the fit drags seen joints along: the marker on a shoulder moves with the arm,
and where a raised arm has no markers of its own (UI-PRMD m06_s04_e05) a pull of 0.3 rad puts the shoulder 36 mm off
instead of 8. Such markers are compared with the pose before the rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.resting_posture import PARTS, rest_rotations
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.partial_body.assumed_above import assumed_joints, assumed_places, with_assumed_spread
from solver_backend.fitters.partial_body.informed_parts import resting_shares
from solver_backend.fitters.partial_body.resting_spread import stance, with_resting_spread
from solver_backend.fitters.solution import SolvedFrames
from solver_backend.geometry.arrays import Array, constant, to_numpy
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.geometry.runs import true_runs

_NAMES = {"upper_arm": "upper arm", "forearm": "forearm", "thigh": "thigh", "shank": "lower leg"}


def rest_parts(measurements: Measurements, solved: SolvedFrames, pinned: Sequence[int] = ()) -> SolvedFrames:
    """Return the poses with the parts that no landmark informs at rest; the same object where there are none.

    Args:
        measurements: what was solved from.
        solved: F poses.
        pinned: see ``resting_shares``.
    """
    subject, frames = solved.subject, solved.frames
    body, layout = subject.body, subject.body.layout.recorded
    offsets, seen = to_numpy(subject.offsets), measurements.seen
    found = resting_shares(body, subject.landmarks, offsets, measurements.located, seen, measurements.fps, pinned)
    shares = found.rest
    if not found.spread:
        return solved
    below = {part: _below(layout, part) for part in found.spread}
    if not shares:  # every part is informed, some of them not to the take's ends
        return replace(solved, covariance=_spread_out(solved, measurements.fps, layout, below, found.spread))
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
    covariance = _spread_out(known, measurements.fps, layout, below, found.spread)
    if contacts is not None:
        feet = [layout.joints.index(f"{side}_foot") for side in ("left", "right")]
        contacts = contacts & (resting[:, feet] == 0.0)
    return replace(
        solved, frames=frames, covariance=covariance, contacts=contacts, fitted=fitted, resting=resting > 0.0,
        diagnostics=(
            *solved.diagnostics, *_diagnose(shares, markers=measurements.marker_labels is not None),
            *([diagnostic("place_assumed", part=where, mm=1000 * sigma_m)] if where else []),
        ),
    )  # fmt: skip


def _spread_out(
    solved: SolvedFrames,
    fps: float,
    layout: BodyLayout,
    below: dict[str, tuple[str, ...]],
    shares: dict[str, np.ndarray],
) -> Array | None:
    """Return the covariances with the spread of what is hardly known, None where there are none."""
    if solved.covariance is None:
        return None
    body, frames = solved.subject.body, solved.frames
    posed = forward_kinematics(body, solved.subject.betas, frames.root, frames.local, frames.transl)
    G, pelvis = to_numpy(posed.G), to_numpy(posed.joints)[:, 0]
    spread = with_resting_spread(
        to_numpy(solved.covariance),
        G[:, list(body.recorded_joints)],
        stance(G[:, 0], pelvis, fps),
        layout,
        below,
        shares,
    )
    return constant(spread, solved.covariance)


def _rested(body: Body, root: np.ndarray, local: np.ndarray, shares: dict[str, np.ndarray]) -> np.ndarray:
    """Return the local rotations, each part's turned from the fit's to those at rest by its share."""
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
    """Return the joints whose places the turns of a part move."""
    moved, turned = set(), {layout.joints.index(name) for name in PARTS[part] if name in layout.joints}
    for j, parent in enumerate(layout.parents):
        if parent in turned or parent in moved:
            moved.add(j)
    return tuple(layout.joints[j] for j in sorted(moved))


def _diagnose(shares: dict[str, np.ndarray], *, markers: bool) -> Iterator[Diagnostic]:
    """Yield what rests: parts that rest in the same frames together."""
    by_runs: dict[tuple[tuple[int, int], ...], list[str]] = {}
    for part, share in shares.items():
        by_runs.setdefault(tuple(true_runs(share > 0.0)), []).append(part)
    for runs, parts in by_runs.items():
        runs = () if runs == ((0, len(shares[parts[0]]) - 1),) else runs
        words = listed(parts)
        several = " and " in words or words.endswith("s")
        lack = "have no markers" if several else "has no markers"
        if not markers:
            lack = "are not seen" if several else "is not seen"
        code = "parts_at_rest_markers" if markers else "parts_at_rest"
        yield diagnostic(code, frames=runs, part=f"{words} {lack}")


def listed(parts: list[str]) -> str:
    """Return the words for parts of ``PARTS``, both sides and both halves of a limb as one: "Arms and head"."""
    words = []
    for limb, halves in (("arm", ("upper_arm", "forearm")), ("leg", ("thigh", "shank"))):
        sides = {side: [half for half in halves if f"{side}_{half}" in parts] for side in ("left", "right")}
        if sides["left"] == sides["right"] and sides["left"]:
            words += [_NAMES[half] + "s" for half in sides["left"]] if len(sides["left"]) == 1 else [limb + "s"]
            continue
        for side, found in sides.items():
            words += [f"{side} {limb}"] if len(found) == 2 else [f"{side} {_NAMES[half]}" for half in found]
    words += [part for part in ("trunk", "head") if part in parts]
    text = " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
    return text[:1].upper() + text[1:]
