"""List the possible faults of a capture's files, with their interpretations and costs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from itertools import combinations, permutations, product

import numpy as np

from solver_backend.agreement.body_evidence import refit_pose
from solver_backend.agreement.evidence import TakeEvidence
from solver_backend.agreement.picture_fit import FREE, FREE_OF_ONE, fit_window
from solver_backend.agreement.reading import PLAIN, PictureReading, Reading
from solver_backend.cameras.camera_corrections import FACTORS, POSES, TURNS

LEAST_DELAY, LONGEST_DELAY = 3, 30
"""Delays to try, in frames. The solve measures shorter ones, and ``find_starts`` handles longer ones."""
SIDES_ODDS = 3000  # Odds against a detector that swaps left and right in all views of upright images.
MOST_PERMUTED = 4
"""Largest number of suspects for which all orders of names are tried. With more, only swaps of two are tried."""


Row = Callable[[TakeEvidence, Reading], Iterator[Reading]]
"""Proposes interpretations that differ from a given one by one kind of fault."""


def conventions(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose that all files share one convention of poses, axes and images."""
    mirrors = [(turn, mirrored) for turn, mirrored in product(TURNS, (False, True)) if not (mirrored and turn == 3)]
    for pose, graphics, size, (turn, mirrored) in product(POSES, (False, True), FACTORS, mirrors):
        pictures = (PictureReading(size, turn, mirrored),) * evidence.views
        yield replace(reading, pictures=pictures, pose=pose, graphics=graphics, sides=(False,) * evidence.views)


def _one_picture(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose another image size or rotation of one camera, mirrored images or swapped sides."""
    for view in evidence.suspects:
        for size, turn in product(FACTORS, TURNS):
            yield reading.with_picture(view, replace(reading.pictures[view], size=size, turn=turn))
    yield from _flipped(evidence, reading)


def _flipped(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose mirrored images of one camera, swapped sides, or both."""
    for view in evidence.suspects:
        picture, other = reading.pictures[view], not reading.sides[view]
        flipped = replace(picture, mirrored=not picture.mirrored)
        yield reading.with_picture(view, flipped)
        yield reading.with_picture(view, flipped, other)
        yield reading.with_picture(view, picture, other)


def exchange_names(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose swapped names of any two suspects, and a shift of all names around the ring."""
    for shift in range(evidence.views):  # also without suspects: most views of a ring agree then
        yield replace(reading, owners=tuple(np.roll(reading.owners, -shift).tolist()))
    views = np.array(evidence.suspects)
    if len(views) <= MOST_PERMUTED:
        orders = [np.array(order) for order in permutations(views)]
    else:
        orders = [np.where(views == a, b, np.where(views == b, a, views)) for a, b in combinations(views, 2)]
    for order in orders:
        owners = np.array(reading.owners)
        owners[views] = owners[order]
        yield replace(reading, owners=tuple(owners.tolist()))


def windows(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose that all recorded images are another crop of the calibrated ones, or are squeezed."""
    common, _ = reading.common()
    sized = [replace(reading, pictures=(replace(common, size=size),) * evidence.views) for size in FACTORS]
    for start in dict.fromkeys([reading, sized[int(evidence.likelihoods(sized)[0].argmax())]]):
        yield from (fit_window(evidence, start, free) for free in FREE)


def one_window(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose squeezed images of the camera without which the others agree best."""
    without = [replace(reading, left_out=(view,)) for view in evidence.suspects]
    view = evidence.suspects[int(evidence.noise(without).density.argmax())]
    yield from (fit_window(evidence, reading, free, (view,)) for free in FREE_OF_ONE)


def _moved(evidence: TakeEvidence, reading: Reading, *, turned: bool = False) -> Iterator[Reading]:
    """Propose that one camera moved after calibration, with its pose fitted to the others."""
    if evidence.views < 3 or reading.moved:
        return
    for view in evidence.suspects:
        pose = refit_pose(evidence, reading, view, turned=turned)
        if pose is not None:
            yield reading.with_pose(view, pose)


def _late(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose that one camera is late or early by whole frames, first in steps of three."""
    reach = min(LONGEST_DELAY, evidence.num_frames // 5)
    for view in evidence.suspects[evidence.views == 2 :]:
        tried = [reading.with_delay(view, lag) for lag in range(-reach, reach + 1, 3)]
        best = tried[int(evidence.likelihoods(tried)[0].argmax())].late
        middle = best[view] if best else 0
        for lag in range(middle - 2, middle + 3):
            if abs(lag) >= LEAST_DELAY:
                yield reading.with_delay(view, lag)


def _left_out(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose to exclude a camera that nothing explains."""
    if evidence.views > 2 and not reading.left_out:
        for view in evidence.suspects:
            yield replace(reading, left_out=(view,))


ROWS: tuple[Row, ...] = (_one_picture, exchange_names)
CAMERA_ROWS: tuple[Row, ...] = (_late, _moved, _left_out)
"""Hypotheses about a camera instead of files, for cameras that nothing else explains."""
RANGE_ROWS: tuple[Row, ...] = (_flipped, exchange_names, partial(_moved, turned=True), _left_out)
"""Faults in a frame range. Crops and conventions are tried for whole takes only, because their fits take time."""


def cost_of(reading: Reading, constraints: float) -> float:
    """Return an interpretation's cost: log(alternatives) per change, log(n) / 2 per parameter.

    Args:
        constraints: number n of independent constraints in the capture.

    Reference: Schwarz 1978.
    """
    views = len(reading.pictures)
    common, sides = reading.common()
    alone = sides and not common.mirrored  # in mirrored images a detector swaps the sides
    cost = np.log(8) * ((reading.pose != POSES[0]) + reading.graphics) + np.log(SIDES_ODDS) * alone
    cost += _picture_cost(common, PLAIN, constraints)
    for picture, exchanged in zip(reading.pictures, reading.sides, strict=True):
        if (picture, exchanged) != (common, sides):
            cost += np.log(views) + _picture_cost(picture, common, constraints) + np.log(4) * (exchanged != sides)
    named = sum(owner != view for view, owner in enumerate(reading.owners))
    cost += (named > 0) * np.log(max(views * (views - 1) // 2, 2)) + max(named - 2, 0) * np.log(max(views, 2))
    cost += sum(lag != 0 for lag in reading.late) * np.log(2 * LONGEST_DELAY * views)
    cost += len(reading.left_out) * np.log(views)
    placed = sum(pose is not None for pose in reading.moved)
    placed += sum(picture.window != common.window for picture in reading.pictures)  # rarer than a moved camera
    return float(cost + placed * (np.log(views) + 3 * np.log(max(constraints / views, 2.0))))


@lru_cache(maxsize=4096)
def _picture_cost(picture: PictureReading, usual: PictureReading, constraints: float) -> float:
    is_fitted = picture.size not in FACTORS and picture.size != usual.size
    fitted = is_fitted + sum(a != b for a, b in zip(picture.window, usual.window, strict=True))
    return float(
        (picture.size != usual.size) * np.log(len(FACTORS))
        + (picture.turn != usual.turn) * np.log(4)
        + (picture.mirrored != usual.mirrored) * np.log(4)
        + (picture.window != usual.window) * np.log(len(FREE))
        + fitted * 0.5 * np.log(max(constraints, 2.0))
    )


def changes_of(reading: Reading) -> list[tuple[str, tuple[int, ...], str, Reading]]:
    """Return the changes as (code, views, text for users, interpretation without this change)."""
    views = len(reading.pictures)
    everyone, changes = tuple(range(views)), list[tuple[str, tuple[int, ...], str, Reading]]()
    written = Reading.as_written(views)
    conventions = replace(written, pose=reading.pose, graphics=reading.graphics)
    if conventions != written:
        phrase = conventions.correction(0).meaning()
        changes.append(("calibration_corrected", everyone, phrase, replace(reading, pose=POSES[0], graphics=False)))
    by_kind: dict[tuple[PictureReading, bool], list[int]] = {}
    for view, kind in enumerate(zip(reading.pictures, reading.sides, strict=True)):
        if kind != (PLAIN, False):
            by_kind.setdefault(kind, []).append(view)
    for (picture, sides), members in by_kind.items():
        without = reading
        for view in members:
            without = without.with_picture(view, PLAIN, False)
        if meaning := picture.correction.meaning():
            changes.append(("calibration_corrected", tuple(members), meaning, without))
        names = "left and right are swapped in the keypoint names"
        flips = [part for part in (picture.mirror_meaning, names if sides else "") if part]
        if flips:
            changes.append(("detections_corrected", tuple(members), ", and ".join(flips), without))
    named = tuple(view for view, owner in enumerate(reading.owners) if owner != view)
    if named:
        changes.append(("camera_names_exchanged", named, "", replace(reading, owners=everyone)))
    moved = tuple(view for view in everyone if reading.pose_of(view) is not None)
    late = tuple(view for view, lag in enumerate(reading.late) if lag)
    changes += [("camera_late", (view,), "", replace(reading, late=())) for view in late]
    changes += [("camera_unexplained", (view,), "", replace(reading, left_out=())) for view in reading.left_out]
    changes += [("camera_placed", (view,), "", replace(reading, moved=())) for view in moved]
    return changes
