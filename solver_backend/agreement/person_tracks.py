"""Find people in space by grouping the detections of each frame, and track them over time.

Rays of every pair of detections from two views are intersected at the midpoint of their shortest segment. Pairs with
intersecting rays are projected into all other views, and the nearest detection in each is added. Distances are in
metres at the person's depth, so one tolerance fits all lenses. Each comparison also tries swapped sides.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product
from math import dist

import numpy as np

from solver_backend.agreement.evidence import SAMPLED_FRAMES, STRIDE
from solver_backend.agreement.reading import MIN_POINTS, Sightings, extent
from solver_backend.exchange.progress import Progress
from solver_backend.geometry.arrays import quantile
from solver_backend.types import Cameras

TOLERANCE_M = 0.15  # Largest median distance of the keypoints in a person's detection.
SMALLEST_ANGLE_SIN2 = 0.0076  # Squared sine of the smallest angle between two rays that locate a point, 5 degrees.


@dataclass(frozen=True)
class PeopleInSpace:
    """H groups of detections. Each group belongs to one frame and is, or may be, one person."""

    frame: np.ndarray  # (H,) frame of each, ascending.
    members: np.ndarray  # (H, C) index of each view's detection, -1 without one.
    points: np.ndarray  # (H, J, 3) world metres of the compared keypoints, NaN where unknown.
    score: np.ndarray  # (H,) sum over its views of 1 - distance / tolerance.

    def at(self, rows: np.ndarray) -> PeopleInSpace:
        """Return the people with the given row numbers."""
        return PeopleInSpace(self.frame[rows], self.members[rows], self.points[rows], self.score[rows])


def candidates(seen: Sightings, progress: Progress) -> PeopleInSpace:
    """Return all groups of detections that may be people.

    Groups may share detections, as rays of different people can meet by chance. ``assigned_exclusively`` resolves this.
    """
    frames, blocks = seen.xy.shape[1], list[tuple[np.ndarray, ...]]()
    for start in range(0, frames, SAMPLED_FRAMES):  # bounds memory
        stop = min(start + SAMPLED_FRAMES, frames)
        block = Sightings(seen.cameras, seen.xy[:, start:stop], seen.mirror)
        frame, points = _seeds(block)
        members, swapped, _ = gather(block, frame, points)
        several = (members >= 0).sum(1) >= 2  # each combination of detections of two views or more counts once
        rows, first = np.unique(np.column_stack([frame, members])[several], axis=0, return_index=True)
        frame, members = rows[:, 0], rows[:, 1:]
        points = _intersection(block, frame, members, swapped[several][first])
        members, _, score = gather(block, frame, points)
        several = (members >= 0).sum(1) >= 2
        blocks.append((frame[several] + start, members[several], points[several], score[several]))
        progress("Comparing the views", stop, frames)
    return PeopleInSpace(*(np.concatenate(values) for values in zip(*blocks, strict=True)))


def _seeds(seen: Sightings) -> tuple[np.ndarray, np.ndarray]:
    present = seen.present()
    frames: list[np.ndarray] = [np.zeros(0, np.int64)]
    points: list[np.ndarray] = [np.zeros((0, seen.xy.shape[3], 3))]
    for a, b in combinations(range(len(seen.cameras)), 2):
        frame, p, q = np.nonzero(present[a][:, :, None] & present[b][:, None, :])
        first, second = seen.xy[a, frame, p], seen.xy[b, frame, q]
        for swapped in (False, True):
            middle, gap = _midpoints(seen.cameras, a, b, first, second[:, seen.mirror] if swapped else second)
            meets = _median(gap) < TOLERANCE_M
            frames.append(frame[meets])
            points.append(middle[meets])
            frame, first, second = frame[~meets], first[~meets], second[~meets]
    return np.concatenate(frames), np.concatenate(points)


def _midpoints(cameras: Cameras, a: int, b: int, n_a: np.ndarray, n_b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return midpoint (N, J, 3) and length (N, J) of the shortest segment between rays in metres.

    Both are NaN if a keypoint is missing, the rays are nearly parallel, or they intersect behind a camera (midpoint
    method; Hartley and Sturm 1997, "Triangulation").
    """
    d_a, d_b = ray_directions(cameras, a, n_a), ray_directions(cameras, b, n_b)
    base = cameras.centres[b] - cameras.centres[a]
    along_a, along_b, cosine = d_a @ base, d_b @ base, (d_a * d_b).sum(-1)
    spread = 1.0 - cosine**2
    usable = spread > SMALLEST_ANGLE_SIN2
    spread = np.where(usable, spread, np.nan)
    s, u = (along_a - cosine * along_b) / spread, (cosine * along_a - along_b) / spread
    p_a = cameras.centres[a] + s[..., None] * d_a
    p_b = cameras.centres[b] + u[..., None] * d_b
    ahead = (s > 0) & (u > 0)
    middle = np.where(ahead[..., None], (p_a + p_b) / 2, np.nan)
    return middle, np.where(ahead, np.linalg.norm(p_a - p_b, axis=-1), np.nan)


def ray_directions(cameras: Cameras, c: int, n: np.ndarray) -> np.ndarray:
    """Return unit ray directions (..., 3) in the world for normalised coordinates (..., 2)."""
    ray = n @ cameras.R[c][:2] + cameras.R[c][2]
    return ray / np.sqrt(1.0 + (n * n).sum(-1))[..., None]


def gather(seen: Sightings, frame: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the detections in all views of people at (N, J, 3) world points, and their agreement.

    Returns:
        Members (N, C), -1 without a detection, mask (N, C) of swapped sides, and score (N,) as in ``PeopleInSpace``.
    """
    members = np.full((len(frame), len(seen.cameras)), -1)
    swaps = np.zeros(members.shape, bool)
    score = np.zeros(len(frame))
    for c in range(len(seen.cameras)):
        fit, distance, swapped = detection_distances(seen, c, frame, points)
        best = np.argmax(np.where(distance < TOLERANCE_M, fit, -1.0), axis=1)[:, None]
        nearest = np.take_along_axis(distance, best, axis=1)[:, 0]
        members[:, c] = np.where(nearest < TOLERANCE_M, best[:, 0], -1)
        swaps[:, c] = np.take_along_axis(swapped, best, axis=1)[:, 0]
        score += np.maximum(0.0, 1.0 - nearest / TOLERANCE_M)
    return members, swaps, score


def detection_distances(
    seen: Sightings, c: int, frame: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compare every detection of one view with people at (N, J, 3) world points.

    Returns:
        (N, P) number of keypoints at their expected positions (a soft count), (N, P) median distance in metres at the
            person's depth, infinity for too few keypoints, and an (N, P) mask of swapped left and right.
    """
    local = points @ seen.cameras.R[c].T + seen.cameras.t[c]
    depth = np.where(local[..., 2] > 0.05, local[..., 2], np.nan)
    expected = local[..., :2] / depth[..., None]
    fits, distances, swaps = [], [], []
    for p in range(seen.xy.shape[2]):
        found = seen.xy[c, frame, p]
        fit, distance = _fit(found, expected, depth)
        swapped_fit, swapped_distance = _fit(found[:, seen.mirror], expected, depth)
        swapped = swapped_distance < distance
        swaps.append(swapped)
        fits.append(np.where(swapped, swapped_fit, fit))
        distances.append(np.where(swapped, swapped_distance, distance))
    return np.stack(fits, axis=1), np.stack(distances, axis=1), np.stack(swaps, axis=1)


def _fit(found: np.ndarray, expected: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N,) soft counts of keypoints at expected positions, and (N,) median distances in metres."""
    across, down = found[..., 0] - expected[..., 0], found[..., 1] - expected[..., 1]
    distance = np.sqrt(across * across + down * down) * depth
    fit = np.where(distance < 2 * TOLERANCE_M, 1.0 - distance / (2 * TOLERANCE_M), 0.0).sum(-1)
    return fit, _median(distance)


def _median(values: np.ndarray) -> np.ndarray:
    enough = np.isfinite(values).sum(-1) >= MIN_POINTS
    return np.where(enough, quantile(values, 0.5, axis=-1, method="lower"), np.inf)


def _intersection(seen: Sightings, frame: np.ndarray, members: np.ndarray, swapped: np.ndarray) -> np.ndarray:
    """Return the (N, J, 3) points nearest to all rays in metres: ``Σ (I - d dᵀ) x = Σ (I - d dᵀ) c``.

    Midpoint method (Hartley and Sturm 1997, "Triangulation") for any number of rays from centres c in directions d.
    """
    count, joints = len(frame), seen.xy.shape[3]
    A, b = np.zeros((count, joints, 3, 3)), np.zeros((count, joints, 3))
    used = np.zeros((count, joints), np.int64)
    for c in range(len(seen.cameras)):
        n = np.where((members[:, c] >= 0)[:, None, None], seen.xy[c, frame, members[:, c]], np.nan)
        n = np.where(swapped[:, c, None, None], n[:, seen.mirror], n)
        known = np.isfinite(n[..., 0])
        d = np.where(known[..., None], ray_directions(seen.cameras, c, np.nan_to_num(n)), 0.0)
        across = np.where(known[..., None, None], np.eye(3), 0.0) - d[..., :, None] * d[..., None, :]
        A += across
        b += across @ seen.cameras.centres[c]
        used += known
    # Two rays at an angle have the determinant 2 sin². More rays increase it.
    solvable = (used >= 2) & (np.linalg.det(A) > 2 * SMALLEST_ANGLE_SIN2)
    A = np.where(solvable[..., None, None], A, np.eye(3))
    return np.where(solvable[..., None], np.linalg.solve(A, b[..., None])[..., 0], np.nan)


SPEED_M_S = 4.0  # Largest speed between two sightings. Doubled if both are in one track of a view.
BRIDGE_S = 0.5  # Longest absence within a tracklet.


def persons(people: PeopleInSpace, tracks: np.ndarray, fps: float) -> list[np.ndarray]:
    """Link people over time. Return each person's rows of ``people``, starting with the best agreement.

    Agreement is the sum of (score - 1)² over the rows, so one frame in four views counts as nine in two. A person who
    never moves, such as a mannequin, has half the weight. ``tracks`` is the result of ``view_tracks``.
    """
    if not len(people.frame):
        return []
    middles = quantile(people.points, 0.5, axis=1, method="lower")
    views = np.arange(people.members.shape[1])
    numbers = np.where(people.members >= 0, tracks[views, people.frame[:, None], people.members], -1)
    in_views = [frozenset(n for n in row if n >= 0) for row in numbers.tolist()]
    found = list[np.ndarray]()
    for rows in _joined(_tracklets(people.frame, middles, in_views, fps), people.frame, middles, in_views, fps):
        ordered = rows[np.lexsort([-people.score[rows], people.frame[rows]])]
        found.append(ordered[np.unique(people.frame[ordered], return_index=True)[1]])  # the best row of each frame
    return [found[i] for i in np.argsort([_weight(people, rows) for rows in found])[::-1]]


def _weight(people: PeopleInSpace, rows: np.ndarray) -> float:
    agreement = np.maximum(people.score[rows] - 1.0, 0.05) ** 2
    points = people.points[rows]
    low, high = (np.quantile(np.nan_to_num(points), q, axis=0) for q in (0.1, 0.9))
    moves = min(1.0, float(np.median(np.linalg.norm(high - low, axis=-1))) / TOLERANCE_M)
    return float(agreement.sum()) * (0.5 + 0.5 * moves)


def _tracklets(frames: np.ndarray, middles: np.ndarray, in_views: list[frozenset[int]], fps: float) -> list[np.ndarray]:
    """Link people in consecutive frames: first those with common tracks in single views, then the nearest ones."""
    found, active = list[list[int]](), list[list[int]]()
    starts, at, positions = np.flatnonzero(np.diff(frames, prepend=-1)).tolist(), frames.tolist(), middles.tolist()
    for start, stop in zip(starts, [*starts[1:], len(frames)], strict=True):
        active = [rows for rows in active if at[start] - at[rows[-1]] <= BRIDGE_S * fps]
        links, linked = [], set[int]()
        for rows in active:
            reach = TOLERANCE_M + SPEED_M_S * min(at[start] - at[rows[-1]], STRIDE) / fps
            for row in range(start, stop):
                shared = len(in_views[rows[-1]] & in_views[row])
                distance = dist(positions[rows[-1]], positions[row])
                if distance <= (2 * reach if shared else reach):
                    links.append((-shared, distance, len(rows), row, rows))
        for _, _, length, row, rows in sorted(links, key=lambda link: link[:2]):
            if len(rows) == length and row not in linked:  # neither is linked yet
                linked.add(row)
                rows.append(row)
        fresh = [[row] for row in range(start, stop) if row not in linked]
        active += fresh
        found += fresh
    return [np.array(rows) for rows in found]


def _joined(
    tracklets: list[np.ndarray], frames: np.ndarray, middles: np.ndarray, in_views: list[frozenset[int]], fps: float
) -> list[np.ndarray]:
    """Join tracklets that follow each other in time: first those with common tracks of views, then the nearest ones."""
    first = np.array([frames[rows[0]] for rows in tracklets])
    last = np.array([frames[rows[-1]] for rows in tracklets])
    begin = np.stack([middles[rows[0]] for rows in tracklets])
    end = np.stack([middles[rows[-1]] for rows in tracklets])
    absence_s = (first[None, :] - last[:, None]) / fps
    distance = np.linalg.norm(end[:, None] - begin[None], axis=-1)
    cost = distance / (2 * TOLERANCE_M + SPEED_M_S * np.maximum(absence_s, 0.0))
    ends = [frozenset().union(*(in_views[row] for row in rows[-5:])) for rows in tracklets]
    begins = [frozenset().union(*(in_views[row] for row in rows[:5])) for rows in tracklets]
    shared = np.array([[len(a & b) for b in begins] for a in ends])
    later = (first[None, :] > first[:, None]) & (last[None, :] > last[:, None])
    follows = later & (absence_s > -np.where(shared > 0, BRIDGE_S, STRIDE / fps))  # pieces of wrongly paired detections
    possible = follows & (cost < np.where(shared > 0, 3.0, 1.0))
    # A common track shows who it is, so the distance does not count. The last term prefers the shorter absence.
    total = np.where(shared > 0, 0.0, cost) - 3.0 * shared + 0.1 * np.log1p(np.maximum(absence_s, 0.0))
    before, after = np.nonzero(possible)
    chain = _chained(len(tracklets), before, after, total[possible])
    return [np.concatenate([tracklets[i] for i in np.flatnonzero(chain == start)]) for start in np.unique(chain)]


def _chained(count: int, before: np.ndarray, after: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """Link pairs of ``count`` items, the cheapest first. Return the first item of each one's chain.

    An item is linked to at most one item before it and one after it.
    """
    previous, is_last = np.arange(count), np.ones(count, bool)
    order = np.argsort(cost, kind="stable")
    for a, b in zip(before[order].tolist(), after[order].tolist(), strict=True):
        if is_last[a] and previous[b] == b:
            is_last[a], previous[b] = False, a
    return _firsts(previous)


def _firsts(previous: np.ndarray) -> np.ndarray:
    while (previous != previous[previous]).any():  # each round doubles the steps back
        previous = previous[previous]
    return previous


STEP_SHARE = 0.2  # Largest movement of a person's keypoints per frame, relative to the person's size.


def view_tracks(xy: np.ndarray) -> np.ndarray:
    """Return (C, F, P) unique track numbers of detections at xy (C, F, P, J, 2), -1 without a detection.

    Two detections in consecutive frames are linked if they are nearest to each other, and all others are at least twice
    as far away. Ambiguous frames, such as those with two crossing people, end a track.
    """
    present, links = np.isfinite(xy[..., 0]).sum(-1) >= MIN_POINTS, np.stack([_links(view) for view in xy])
    number = np.arange(present.size).reshape(present.shape)
    before = np.take_along_axis(number[:, :-1], np.maximum(links, 0), axis=2)
    number[:, 1:] = np.where(links >= 0, before, number[:, 1:])
    tracks = np.where(present, 0, -1)
    tracks[present] = np.unique(_firsts(number.ravel())[present.ravel()], return_inverse=True)[1]
    return tracks


def joined_tracks(xy: np.ndarray, fps: float) -> np.ndarray:
    """Join the ``view_tracks`` (F, P) of one view over absences and ambiguous frames, the nearest ends first."""
    tracks, points, most = view_tracks(xy[None]).ravel(), xy.reshape(-1, *xy.shape[2:]), xy.shape[1]
    shown = np.flatnonzero(tracks >= 0)
    first, last = (rows[np.unique(tracks[rows], return_index=True)[1]] for rows in (shown, shown[::-1]))
    begins, ends = first // most, last // most
    low, high = (np.searchsorted(begins, ends + frames, "right") for frames in (0, max(1, round(BRIDGE_S * fps))))
    count = np.minimum(high - low, 2 * most)  # bounds memory
    before = np.repeat(np.arange(len(ends)), count)
    after = np.arange(len(before)) + np.repeat(low + count - np.cumsum(count), count)
    one, other = points[last[before]], points[first[after]]
    size = np.maximum(np.fmax(extent(one), extent(other)), 1e-6)
    cost = quantile(np.linalg.norm(other - one, axis=-1), 0.5, axis=-1) / size
    near = cost < 2 * STEP_SHARE
    tracks[shown] = _chained(len(first), before[near], after[near], cost[near])[tracks[shown]]
    return tracks.reshape(xy.shape[:2])


def _links(xy: np.ndarray) -> np.ndarray:
    cost = _costs(xy)
    if not cost.size:
        return np.zeros(cost.shape[:2], np.int64)
    before, after, best = cost.argmin(axis=1), cost.argmin(axis=2), cost.min(axis=1)
    mutual = np.take_along_axis(after, before, axis=1) == np.arange(cost.shape[1])
    padded = np.pad(cost, ((0, 0), (0, 1), (0, 1)), constant_values=np.inf)
    backward, forward = (np.partition(padded, 1, axis=axis).take(1, axis)[:, :-1] for axis in (1, 2))
    clear = np.minimum(backward, np.take_along_axis(forward, before, axis=1)) > 2 * best
    return np.where(mutual & clear & (best < STEP_SHARE), before, -1)


def _costs(xy: np.ndarray) -> np.ndarray:
    """Return mean keypoint distances (F-1, P, P) of consecutive frames in person sizes, infinity if too few match."""
    known = np.isfinite(xy[..., :1])
    count = np.maximum(known.sum(-2), 1)
    middle = np.where(known, xy, 0.0).sum(-2) / count
    spread = np.where(known, xy - middle[..., None, :], 0.0)
    size = 3.0 * np.sqrt((spread**2).sum((-1, -2)) / count[..., 0])  # a swung arm changes it less than a box
    people = range(xy.shape[1])
    cost = np.full((max(len(xy) - 1, 0), len(people), len(people)), np.inf)
    for p, q in product(people, people):
        apart = np.linalg.norm(xy[1:, q] - xy[:-1, p], axis=-1)
        common = np.isfinite(apart).sum(-1)
        scale = np.maximum(np.minimum(size[1:, q], size[:-1, p]), 1e-6) * np.maximum(common, 1)
        cost[:, p, q] = np.where(common >= MIN_POINTS, np.nan_to_num(apart).sum(-1) / scale, np.inf)
    return cost


def assigned_exclusively(people: PeopleInSpace, tracks: np.ndarray) -> PeopleInSpace:
    """Select the best groups in each frame, such that no two groups have a detection in common.

    A group's score is multiplied by the fraction of frames in which its ``view_tracks`` agree, because the rays of
    different people meet in some frames only.
    """
    score: np.ndarray = people.score * _lasting_agreement(people, tracks)
    left = np.ones(len(score), bool)
    chosen = np.zeros(len(score), bool)
    order = np.lexsort([-score, people.frame])
    while left.any():
        open_rows = order[left[order]]
        winners = open_rows[np.unique(people.frame[open_rows], return_index=True)[1]]
        chosen[winners] = True
        taken = np.full((int(people.frame.max()) + 1, people.members.shape[1]), -2)
        taken[people.frame[winners]] = people.members[winners]
        left &= ~((people.members == taken[people.frame]) & (people.members >= 0)).any(1)
    return people.at(order[chosen[order]])


def _lasting_agreement(people: PeopleInSpace, tracks: np.ndarray) -> np.ndarray:
    """Return the (H,) fractions of frames in which the tracks of a group agree, averaged over its pairs of views."""
    views = people.members.shape[1]
    size, shown = int(tracks.max(initial=-1)) + 1, tracks >= 0  # tracks have no gaps
    first, last = np.full(size, tracks.shape[1]), np.full(size, -1)
    np.minimum.at(first, tracks[shown], np.nonzero(shown)[1])
    np.maximum.at(last, tracks[shown], np.nonzero(shown)[1])
    number = np.where(people.members >= 0, tracks[np.arange(views), people.frame[:, None], people.members], -1)
    total, pairs = np.zeros(len(people.frame)), np.zeros(len(people.frame))
    for a, b in combinations(range(views), 2):
        rows = np.flatnonzero((number[:, a] >= 0) & (number[:, b] >= 0))
        if not len(rows):
            continue
        i, j = number[rows, a], number[rows, b]
        # A pair of views in several groups of one frame counts once.
        once = np.unique(np.column_stack([people.frame[rows], i, j]), axis=0)[:, 1:]
        kinds, agreed = np.unique(once, axis=0, return_counts=True)
        together = last[kinds].min(axis=1) - first[kinds].max(axis=1) + 1
        share = (agreed + 0.5) / (together + 1.5)
        keys = kinds[:, 0] * len(first) + kinds[:, 1]
        total[rows] += share[np.searchsorted(keys, i * len(first) + j)]
        pairs[rows] += 1
    return total / np.maximum(pairs, 1)
