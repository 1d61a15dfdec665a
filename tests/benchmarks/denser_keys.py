"""Bound the gain of denser keys in fast motion: ``python -m tests.benchmarks.denser_keys``.

The error is the MPJPE of SIDER-2 through the true codes, rotations and positions at the keys of BundleMoCap++. It has
no noise and no optimiser, and keys are placed by the speed of the true joints, so it bounds the gain of a placement by
measured speed. There are as many keys as published. Four training takes choose the exponent. The twelve takes of the
comparison report it. Needs the validation motions (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from research.baselines import BundleMoCapPlusPlus
from solver_backend.fitters.model.keyframe_curve import KeyframeCurve
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import Keyframes, PosedFrames, hemisphere_aligned
from solver_backend.geometry.rotations import quat_from_matrix
from solver_backend.metrics import mpjpe_mm
from solver_backend.priors.sposer import load_sposer
from solver_backend.synthesis.simulation.cast import Person, cast_person
from solver_backend.types import JointSet
from supply.take_ratios import interval
from tests.benchmarks.comparison.captures import take_of
from tests.benchmarks.comparison.many_takes import TAKES
from tests.benchmarks.comparison.validation_takes import training_take

TRAINING = (("49_02", 300, 600), ("06_02", 300, 60), ("02_01", 300, 20), ("14_14", 300, 290))
"""Name, frames, first frame: dance, basketball, walking, and exercises on the floor. None is in the comparison."""
EXPONENTS = (0.0, 0.25, 0.5, 0.75, 1.0)
LEAST_DENSITY = 0.5  # Lowest density of keys, relative to equal spacing. Chosen by hand.


def main() -> int:
    """Print the errors of every exponent on the training takes, and of the best exponent on the others."""
    people = [cast_person(training_take(*take), np.random.default_rng(n)) for n, take in enumerate(TRAINING)]
    means = {}
    for exponent in EXPONENTS:
        errors = [curve_mm(person, exponent) for person in people]
        means[exponent] = float(np.mean(errors))
        sys.stdout.write(f"training, exponent {exponent:g}: {_text(errors)}, mean {means[exponent]:.2f} mm\n")
    sys.stdout.write(f"training, every frame a key: {_text([codes_mm(person) for person in people])} mm\n")
    best = min(EXPONENTS[1:], key=means.__getitem__)
    held_out = [cast_person(take_of(take), np.random.default_rng(n)) for n, take in enumerate(TAKES)]
    rows = {exponent: [curve_mm(person, exponent) for person in held_out] for exponent in (0.0, best)}
    for exponent, errors in rows.items():
        sys.stdout.write(f"held out, exponent {exponent:g}: {_text(errors)}, mean {np.mean(errors):.2f} mm\n")
    sys.stdout.write(f"held out, every frame a key: {_text([codes_mm(person) for person in held_out])} mm\n")
    ratios = {take: b / a for take, a, b in zip(TAKES, *rows.values(), strict=True)}
    sys.stdout.write("ratio, median and 95 % interval over takes: {:.3f}, {:.3f} to {:.3f}\n".format(*interval(ratios)))
    return 0


def curve_mm(person: Person, exponent: float) -> float:
    """Return the MPJPE of SIDER-2 through the true poses at the keys in millimetres."""
    prior, joints = load_sposer(), person.landmarks(JointSet.SMPL_24).points
    layout = KeyframeLayout.even(len(joints), BundleMoCapPlusPlus().window)
    layout = denser_where_fast(layout, joints, exponent) if exponent else layout
    at = np.round(layout.key_times).astype(int)
    z, quat = prior.encode(person.local[at]), quat_from_matrix(person.orient[at])
    keys = hemisphere_aligned(Keyframes(z, quat, person.transl[at], np.zeros((len(at), 21, 3))))
    window, time = layout.positions(layout.frames)
    parts = [
        KeyframeCurve.through(
            keys.select(np.arange(2 * w, 2 * w + 3)[None]), time[window == w][None], residuals=False
        ).poses(prior)
        for w in range(layout.num_windows)
    ]
    return _error_mm(person, PosedFrames.concatenate(parts))


def denser_where_fast(layout: KeyframeLayout, points: np.ndarray, exponent: float) -> KeyframeLayout:
    """Return as many windows, with lengths proportional to ``speed ** -exponent`` of the (F, K, 3) points.

    The speed is the mean over the points that two frames share, smoothed over an even window. Windows have between half
    and twice the even length.
    """
    step = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    shared = np.isfinite(step)
    speed = np.where(shared, step, 0.0).sum(axis=1) / np.maximum(shared.sum(axis=1), 1)
    width = max(1, round(len(speed) / layout.num_windows))
    padded = np.pad(speed, (width // 2, width - 1 - width // 2), mode="edge")
    smooth = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
    density = np.clip((smooth / smooth.mean()) ** exponent, LEAST_DENSITY, 1.0 / LEAST_DENSITY)
    share = np.concatenate([[0.0], np.cumsum(density)]) / density.sum()
    ends = np.interp(np.linspace(0.0, 1.0, layout.num_windows + 1), share, np.arange(len(share)))
    return replace(layout, bounds=layout.bounds[0] + np.round(ends).astype(np.int64))


def codes_mm(person: Person) -> float:
    """Return the MPJPE in millimetres of the poses that the codes of all frames decode to."""
    prior = load_sposer()
    return _error_mm(person, PosedFrames(person.orient, prior.decode(prior.encode(person.local)), person.transl))


def _error_mm(person: Person, frames: PosedFrames) -> float:
    posed = replace(person, orient=frames.root, local=frames.local, transl=frames.transl)
    return mpjpe_mm(posed.landmarks(JointSet.SMPL_24).points, person.landmarks(JointSet.SMPL_24).points)


def _text(errors: Sequence[float]) -> str:
    return " ".join(f"{error:.1f}" for error in errors)


if __name__ == "__main__":
    raise SystemExit(main())
