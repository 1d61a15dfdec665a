"""Pictures of another shape than those calibrated, or of a size that no standard has, by the agreement of views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from solver_backend.agreement.moved_view import agreement_if_turned
from solver_backend.agreement.reading_scores import ReadingScores
from solver_backend.cameras.camera_corrections import FACTORS, SHAPES, CameraCorrection

LEAST_CAMERAS = 3
"""One pair of views alone can be brought to agree in too many ways."""
NEARER, CLEARLY = 0.02, 0.08
"""Distance from epipolar lines, in the person's extent, within which shapes are compared, and how much more must lie
there: the demo squeezed to 3/4 reaches 0.84 when read so, and 0.67 as pictures of 3/4 of the size."""
NEAR_ENOUGH = 0.8
"""Share within ``NEARER`` from which no other shape is looked for."""
COARSE, COARSE_FRAMES = 0.12, 3
"""The same distance, and frames, on which sizes and shapes are found."""
LIKE_CALIBRATED = 0.06
"""Logarithm of a size of whole pictures that no recording has but the calibrated one: so near it is another fault."""
_SIZES = np.geomspace(0.15, 4.0, 38).tolist()
_FINER = np.geomspace(0.95, 1.05, 11).tolist()
"""Sizes of pictures in steps of 9 %, and shares by which the one that is found may be off."""
OTHERS_AGREE = 0.8
"""Share of the keypoints that must agree between the others where one camera alone is tried."""
_STANDARD, _AS_WELL = 0.015, 0.03
"""Logarithm of a size, and share of the keypoints, by which a standard size may be off."""
_OF_ONE = ("squeezed", "widened", "half as wide", "twice as wide", "square", "boxed")
"""Shapes of a single camera: a cut looks as a turn of the camera does, but for the one below."""
_CUT = "cut to a square"
"""The cut of a single phone, known by its exact place and by keypoints that all lie within."""
_INSIDE = 0.99
"""Share of the keypoints that must lie in pictures that are cut so."""
TURNED = 0.03
"""Share of the keypoints by which a shape must explain more than that a camera was turned after it was calibrated, and
by which a cut may explain less. Within ``NEARER`` three takes of three and four phones, one of them turned by 3 to 13
degrees, agree by 0.93 when it is turned back, squeezed ones by 0.63 to 0.75 so and by 0.95 as squeezed."""


def with_shapes(scores: ReadingScores, best: list[CameraCorrection]) -> list[CameraCorrection]:
    """Return a reading in which pictures have another shape or any size, where that is clearly better than ``best``.

    All cameras alike are tried, and the one that agrees least.

    Args:
        scores: of C cameras on few frames.
        best: (C,) the best reading with the shape that was calibrated.
    """
    if len(best) < LEAST_CAMERAS:
        return best
    near = scores.within(NEARER)
    if near.of(best) >= NEAR_ENOUGH:
        return best
    coarse = scores.on(COARSE_FRAMES, list(range(len(best)))).within(COARSE)
    alike = max(set(best), key=best.count)
    worst = min(range(len(best)), key=lambda c: scores.of_camera(c, best))
    everyone = tuple(range(len(best)))
    shaped = [([replace(alike, shape=s)] * len(best), everyone) for s in ("", *SHAPES)]
    others_agree = scores.without(worst).of(best) >= OTHERS_AGREE
    if others_agree:
        shaped += [(_with(best, worst, replace(alike, shape=s)), (worst,)) for s in _OF_ONE]
    found = [_nearest(near, _best_size(coarse, reading, _SIZES, cameras), cameras) for reading, cameras in shaped]
    cut = _with(best, worst, replace(best[worst], shape=_CUT))
    if others_agree and scores.within_picture(worst, cut[worst]) >= _INSIDE:
        found.append(cut)
    chosen = max(found, key=near.of)
    if others_agree:
        more = -TURNED if chosen == cut else TURNED
        if agreement_if_turned(near, best, worst) > near.of(chosen) - more:
            return best
    if not any(r.shape for r in chosen) and abs(np.log(chosen[0].factor / alike.factor)) < LIKE_CALIBRATED:
        return best
    return chosen if near.of(chosen) >= near.of(best) + CLEARLY else best


def _best_size(
    scores: ReadingScores, reading: list[CameraCorrection], sizes: Sequence[float], cameras: tuple[int, ...]
) -> list[CameraCorrection]:
    """Return the reading with the size of these cameras' pictures that scores best."""
    return _of_size(reading, sizes[int(np.argmax(scores.of_sizes(reading, sizes, cameras)))], cameras)


def _of_size(reading: list[CameraCorrection], factor: float, cameras: tuple[int, ...]) -> list[CameraCorrection]:
    return [replace(r, factor=factor) if c in cameras else r for c, r in enumerate(reading)]


def _nearest(near: ReadingScores, reading: list[CameraCorrection], cameras: tuple[int, ...]) -> list[CameraCorrection]:
    """Return the reading with the size of these cameras' pictures that fits best to a few per mille.

    A standard size is taken where it fits about as well.
    """
    found = reading[cameras[0]].factor
    best = _best_size(near, reading, [found * f for f in _FINER], cameras)
    size = best[cameras[0]].factor
    standard = min(FACTORS, key=lambda factor: abs(np.log(factor / size)))
    usual = _of_size(reading, standard, cameras)
    if abs(np.log(standard / size)) < _STANDARD and near.of(usual) > near.of(best) - _AS_WELL:
        return usual
    return best


def _with(reading: list[CameraCorrection], c: int, way: CameraCorrection) -> list[CameraCorrection]:
    return [*reading[:c], way, *reading[c + 1 :]]
