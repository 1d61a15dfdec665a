"""List the possible faults of a capture's files, with their interpretations and costs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from itertools import combinations, product
from math import log
from typing import Any

import numpy as np

from solver_backend.agreement.body_evidence import refit_pose
from solver_backend.agreement.evidence import BOUND, LEAST_NOISE, SCALES, SIGMAS, STRIDE, TakeEvidence
from solver_backend.agreement.reading import MIRROR_MEANINGS, PLAIN, PictureReading, Reading
from solver_backend.cameras.camera_corrections import AS_CALIBRATED, FACTORS, POSES, TURNS
from solver_backend.exchange.diagnostics import Diagnostic, Remedy, diagnostic
from solver_backend.solver.levenberg_marquardt import DenseBlocks, LazyNormalEquations, LMSettings, levenberg_marquardt

_PARTS = ("size", "width", "left", "top")  # Parameters of images: their size and width, and positions of two edges.
FREE = ("width",), ("left", "top"), ("size", "width"), ("size", "left", "top"), _PARTS  # Fitted together.
FREE_OF_ONE = ("width",), ("size", "width")  # The same for a single camera. Its crop would look like a rotation.
CONVERGED = LEAST_NOISE  # Step length of numerical derivatives, and at which a fit ends.
SPREAD = 0.3  # Prior deviation of the logarithms of sizes and widths, and of edges in image heights.


def fit_window(evidence: TakeEvidence, reading: Reading, free: tuple[str, ...], views: tuple[int, ...] = ()) -> Reading:
    """Fit the image size or crop of an interpretation so that the views agree best.

    Levenberg-Marquardt steps with Geman-McClure weights (1987) minimise the epipolar distances. Missing ones count as
    infinite. ``free`` names the fitted parameters. All ``views``, or all views, get the same values.
    """
    views = views or tuple(range(evidence.views))
    x, changes = np.zeros((1, len(free))), np.array([[part == own for part in _PARTS] for own in free]) * 1.0

    def distances(places: np.ndarray) -> np.ndarray:
        readings = [_with(reading, place @ changes, views) for place in places]
        return evidence.distances(readings).reshape(len(places), -1)

    def linearise(x: np.ndarray, width: float) -> tuple[np.ndarray, LazyNormalEquations]:
        square, prior = distances(x) ** 2, (width / SPREAD) ** 2

        def form() -> DenseBlocks:
            off, *moved = np.nan_to_num(distances(np.concatenate([x, x + CONVERGED * np.eye(len(free))])))
            slopes = (np.array(moved) - off) / CONVERGED
            weighted = slopes / (1 + (off / width) ** 2) ** 2
            normal = weighted @ slopes.T + prior * np.eye(len(free))
            return DenseBlocks(normal[None], (weighted @ off)[None] + prior * x)

        cost = np.nan_to_num(square / (1 + square / width**2), nan=width**2)
        return cost.sum(1) + prior * (x**2).sum(1), LazyNormalEquations(form)

    for width in SCALES:
        x = levenberg_marquardt(x, partial(linearise, width=width), np.add, LMSettings(tolerance=CONVERGED)).state
    fitted = enumerate(_with(reading, x[0] @ changes, views).pictures)
    return replace(reading, pictures=tuple(_plain(one) if view in views else one for view, one in fitted))


def _with(reading: Reading, x: np.ndarray, views: tuple[int, ...]) -> Reading:
    pictures, (size, wide, left, top) = list(reading.pictures), [*np.exp(x[:2]).tolist(), *x[2:].tolist()]
    for view in views:
        picture = pictures[view]
        window = (picture.window[0] * wide, picture.window[1] + left, picture.window[2] + top)
        pictures[view] = replace(picture, size=picture.size * size, window=window)
    return replace(reading, pictures=tuple(pictures))


def _plain(picture: PictureReading) -> PictureReading:
    wide, left, top = (
        usual if round(100 * value) == round(100 * usual) else value
        for value, usual in zip(picture.window, AS_CALIBRATED, strict=True)
    )
    size = min(FACTORS, key=lambda factor: abs(picture.size / factor - 1))
    size = size if round(100 * picture.size / size) == 100 else picture.size
    return replace(picture, size=size, window=(wide, left, top))


LONGEST_DELAY = 24  # Longest delay to try, in frames. ``find_starts`` handles longer ones, and the solve shorter ones.


Row = Callable[[TakeEvidence, Reading], Iterator[Reading]]
"""Proposes interpretations that differ from a given one by one kind of fault."""


def conventions(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose conventions of poses, camera axes and images that all files share."""
    mirrors = [(turn, mirrored) for turn, mirrored in product(TURNS, (False, True)) if not (mirrored and turn == 3)]
    for pose, graphics, size, (turn, mirrored) in product(POSES, (False, True), FACTORS, mirrors):
        pictures = (PictureReading(size, turn, mirrored),) * evidence.views
        yield replace(reading, pictures=pictures, pose=pose, graphics=graphics, sides=(False,) * evidence.views)


def _one_picture(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    for view in evidence.suspects:
        for size, turn in product(FACTORS, TURNS):
            yield reading.with_view(view, pictures=replace(reading.pictures[view], size=size, turn=turn))


def _flipped(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    for view in evidence.suspects:
        picture, other = reading.pictures[view], not reading.sides[view]
        flipped = replace(picture, mirrored=not picture.mirrored)
        yield reading.with_view(view, pictures=flipped)
        yield reading.with_view(view, pictures=flipped, sides=other)
        yield reading.with_view(view, sides=other)


def exchange_names(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose that two suspect cameras have swapped names, or that all names are shifted around the ring."""
    for shift in range(evidence.views):  # also without suspects: most views of a ring agree then
        yield replace(reading, owners=tuple(np.roll(reading.owners, -shift).tolist()))
    for a, b in combinations(evidence.suspects, 2):
        yield reading.with_view(a, owners=reading.owners[b]).with_view(b, owners=reading.owners[a])


def windows(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose that all recorded images are squeezed, or show another crop than the calibrated images."""
    common, _ = reading.common()
    sized = [replace(reading, pictures=(replace(common, size=size),) * evidence.views) for size in FACTORS]
    best = sized[int(evidence.likelihoods(sized).argmax())]
    for free in FREE:
        starts = [best] if "size" in free else dict.fromkeys([reading, best])
        yield from (fit_window(evidence, start, free) for start in starts)


def one_window(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose that the images are squeezed in the one camera without which the other views agree best."""
    without = [replace(reading, left_out=(view,)) for view in evidence.suspects]
    view = evidence.suspects[int(evidence.noise(without).density.argmax())]
    yield from (fit_window(evidence, reading, free, (view,)) for free in FREE_OF_ONE)


def _moved(evidence: TakeEvidence, reading: Reading, *, turned: bool = False) -> Iterator[Reading]:
    if evidence.views < 3 or any(reading.moved) or evidence.people > 1:
        return
    for view in evidence.suspects:
        pose = refit_pose(evidence, reading, view, turned=turned)
        if pose is not None:
            yield reading.with_view(view, moved=pose)


def _late(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    """Propose delays of one camera in whole frames, near the best delay of a search in steps of ``STRIDE``."""
    reach = min(LONGEST_DELAY, evidence.num_frames // 5)
    for view in evidence.suspects[evidence.views == 2 :]:
        tried = [reading.with_view(view, late=lag) for lag in range(-reach, reach + 1, STRIDE)]
        middle = tried[int(evidence.likelihoods(tried).argmax())].late[view]
        for lag in range(middle - STRIDE + 1, middle + STRIDE):
            if abs(lag) >= STRIDE:
                yield reading.with_view(view, late=lag)


def _left_out(evidence: TakeEvidence, reading: Reading) -> Iterator[Reading]:
    if evidence.views > 2 and not reading.left_out:
        for view in evidence.suspects:
            yield replace(reading, left_out=(view,))


ROWS: tuple[Row, ...] = (_one_picture, _flipped, exchange_names)
CAMERA_ROWS: tuple[Row, ...] = (_late, _moved, _left_out)
"""Hypotheses about a camera instead of files, for cameras that nothing else explains."""
RANGE_ROWS: tuple[Row, ...] = (_flipped, exchange_names, partial(_moved, turned=True), _left_out)
"""Faults in a frame range. Crops and conventions are tried for whole takes only, because their fits take time."""


def cost_of(reading: Reading, constraints: float) -> float:
    """Return the cost of an interpretation's changes and fitted parameters, in nats.

    A change costs log(alternatives). A fitted parameter costs log(n) / 2 for n independent constraints (Schwarz 1978).
    An image crop also has a prior.
    """
    views = len(reading.pictures)
    common, sides = reading.common()
    alone = sides and not common.mirrored  # in mirrored images a detector swaps the sides
    cost = log(8) * ((reading.pose != POSES[0]) + reading.graphics) + BOUND * alone
    cost += _picture_cost(common, PLAIN, constraints)
    for picture, exchanged in zip(reading.pictures, reading.sides, strict=True):
        if (picture, exchanged) != (common, sides):
            cost += log(views) + _picture_cost(picture, common, constraints) + log(4) * (exchanged != sides)
    named = sum(owner != view for view, owner in enumerate(reading.owners))
    cost += (named > 0) * log(max(views * (views - 1) // 2, 2)) + max(named - 2, 0) * log(max(views, 2))
    cost += sum(map(bool, reading.late)) * log(2 * LONGEST_DELAY * views)
    cost += len(reading.left_out) * log(views)
    placed = sum(pose is not None for pose in reading.moved)
    placed += sum(picture.window != common.window for picture in reading.pictures)  # rarer than a moved camera
    return float(cost + placed * (log(views) + 3 * log(max(constraints / views, 2.0))))


@lru_cache(maxsize=4096)
def _picture_cost(picture: PictureReading, usual: PictureReading, constraints: float) -> float:
    is_fitted = picture.size not in FACTORS and picture.size != usual.size
    fitted = is_fitted + sum(a != b for a, b in zip(picture.window, usual.window, strict=True))
    # Without the prior, images squeezed to a line or a point explain even random points.
    apart = [is_fitted * log(picture.size / usual.size), log(picture.window[0] / usual.window[0])]
    apart += np.subtract(picture.window[1:], usual.window[1:]).tolist()
    if np.abs(apart).max() > SIGMAS * SPREAD:
        return np.inf
    return float(
        0.5 * np.sum((np.array(apart) / SPREAD) ** 2)
        + (picture.size != usual.size) * log(len(FACTORS))
        + (picture.turn != usual.turn) * log(4)
        + (picture.mirrored != usual.mirrored) * log(4)
        + (picture.window != usual.window) * log(len(FREE))
        + fitted * 0.5 * log(max(constraints, 2.0))
    )


_SWAPPED = "left and right are swapped in the keypoint names"


def changes_of(reading: Reading) -> list[tuple[str, tuple[int, ...], str, Reading]]:
    """List the changes as (code, views, text for users, interpretation without this change)."""
    views = len(reading.pictures)
    everyone, changes = tuple(range(views)), list[tuple[str, tuple[int, ...], str, Reading]]()
    written = Reading.as_written(views)
    conventions = replace(written, pose=reading.pose, graphics=reading.graphics)
    if conventions != written:
        phrase = conventions.correction(0).meaning()
        changes.append(("calibration_corrected", everyone, phrase, replace(reading, pose=POSES[0], graphics=False)))
    kinds = list(zip(reading.pictures, reading.sides, strict=True))
    for picture, sides in dict.fromkeys(kinds):
        members = tuple(view for view in everyone if kinds[view] == (picture, sides))
        without = reading
        for view in members:
            without = without.with_view(view, pictures=PLAIN, sides=False)
        if meaning := picture.correction.meaning():
            changes.append(("calibration_corrected", members, meaning, without))
        flips = ((picture.mirrored, MIRROR_MEANINGS[picture.turn]), (sides, _SWAPPED))
        if meaning := ", and ".join(text for is_so, text in flips if is_so):
            changes.append(("detections_corrected", members, meaning, without))
    named = tuple(view for view, owner in enumerate(reading.owners) if owner != view)
    if named:
        changes.append(("camera_names_exchanged", named, "", replace(reading, owners=everyone)))
    changes += [("camera_late", (v,), "", reading.with_view(v, late=0)) for v in everyone if reading.late[v]]
    changes += [("camera_unexplained", (v,), "", replace(reading, left_out=())) for v in reading.left_out]
    changes += [("camera_placed", (v,), "", reading.with_view(v, moved=None)) for v in everyone if reading.moved[v]]
    return changes


def diagnose_views(reading: Reading, names: Sequence[str], **values: Any) -> list[Diagnostic]:
    """Report views with other sides, names and poses than their files say. ``values`` are common to all reports."""
    found = list[Diagnostic]()
    for code, views, meaning, _ in changes_of(reading):
        named = [names[view] for view in views]
        pairs = [f"{names[view]} is the calibration's {names[reading.owners[view]]}" for view in views]
        own: dict[str, dict[str, Any]] = {
            "detections_corrected": {"found": meaning},
            "camera_names_exchanged": {"pairs": pairs},
            "camera_placed": {},
            "camera_unexplained": {"remedy": Remedy.REPORTED},
        }
        if code == "detections_corrected" and reading.pictures[views[0]].mirrored and len(named) < len(names):
            found += [diagnostic("image_mirrored", cameras=[name], **values) for name in named]
        elif code in own:
            found.append(diagnostic(code, cameras=named, **values | own[code]))
    return found
