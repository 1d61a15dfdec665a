"""Label a cloud: the network reads frames, tracklets collect votes, and each label is used once per frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.marker_names import is_unnamed
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.small_matrices import unit
from solver_backend.labelling.outputs import GHOST, LANDMARKS, MARKERS
from solver_backend.labelling.point_network import (
    FEWEST_POINTS,
    LandmarkNetwork,
    read_frames,
    require_at_most,
    require_points,
)
from solver_backend.labelling.tracklets import (
    Tracklets,
    distance_evidence,
    distances_of,
    labels_of_stretches,
    load_distances,
    tracklets_of,
)
from solver_backend.types import MarkerCloud

UNKNOWN = -1  # Label of a point that remains unnamed.
MEMORY_S = 0.15  # Seconds within which readings share their error and count as one.
NETWORK_MOST = 4.0
"""Largest weight of the network in independent readings, because its errors persist throughout a take."""
DISTANCE_SHARE = 1.5  # Weight of the evidence from distances.
BODY_SHARE, BODY_MOST = 0.3, 2.5
"""Weight of the evidence from the body relative to one reading, and its largest weight in readings."""
PASSING, PASSING_S = 5.0, 0.4
"""Additional log likelihood that a briefly visible point is not a marker, and its decay time in seconds."""
SELDOM = np.array([i for i, name in enumerate(MARKERS) if name not in marker_layout("CMU_41")])
SELDOM_COST = 1.5  # Log likelihood penalty for markers that common layouts do not include.
SURE, TRUSTED = 0.8, 0.6  # Smallest probability of a final label, and of a label whose chain helps to label others.
FIRST_AGREED, AGREED = 0.5, 0.4
"""Smallest mean network probability of a label: in the first round, and in all rounds for fitting a body."""
_ROWS = 512  # Number of tracklets compared with all others at once.


@dataclass(frozen=True)
class Votes:
    """The network's results for K frames, and the sums of its votes for the labels of C chains of tracklets."""

    frames: np.ndarray  # (K,) frames that were read.
    landmarks: np.ndarray  # (K, 77, 3) markers and joints in metres.
    covariance: np.ndarray  # (K, 77, 3, 3) covariances in m².
    evidence: np.ndarray  # (C, 54) sums of log probabilities.
    mean: np.ndarray  # (C, 54) mean probabilities.
    count: np.ndarray  # (C,) numbers of readings.


def voted(
    votes: Votes, together: np.ndarray, fps: float, bound: dict[int, int], by_distance: np.ndarray, by_body: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the label and confidence of every chain of tracklets. The label is ``UNKNOWN`` if none is probable enough.

    Four log likelihoods are added for each label: the network's votes, the evidence from distances, the evidence from a
    fitted body, and a prior. The votes of successive frames are similar, so they are reduced to the number of
    independent readings.

    Args:
        together: (C, C) mask of chains that are visible at the same time.
        bound: maps chains to the labels that the user assigned.
        by_distance: result of ``distance_evidence``, or 0.
        by_body: result of ``body_evidence``, or 0.
    """
    between = np.median(np.diff(votes.frames)) / fps if len(votes.frames) > 1 else 1.0
    seconds = votes.count * between
    readings = np.minimum(np.minimum(votes.count, seconds / MEMORY_S), NETWORK_MOST)
    evidence = (readings / np.maximum(votes.count, 1.0))[:, None] * votes.evidence + DISTANCE_SHARE * by_distance
    evidence += np.minimum(BODY_SHARE * seconds / MEMORY_S, BODY_MOST)[:, None] * by_body
    evidence[:, SELDOM] -= SELDOM_COST
    evidence[:, GHOST] += PASSING * np.exp(-seconds / PASSING_S)
    # If two chains claim one marker, the one that is visible longer gets it, because most points are then correct.
    labels = labels_of_stretches((seconds + PASSING_S)[:, None] * evidence, together, bound)
    rows = np.arange(len(labels))
    held = np.zeros(evidence.shape, dtype=np.int64)
    held[rows, labels] = 1
    # A chain cannot have a label that another chain already has while both are visible.
    free = (together.astype(np.int64) @ held) == 0
    free[:, GHOST] = free[rows, labels] = True
    open_ = np.where(free, evidence, -np.inf)
    shifted = np.exp(open_ - open_.max(1, keepdims=True))
    sure = shifted[rows, labels] / shifted.sum(1)
    keep = (sure >= SURE) & (votes.count > 0)
    keep[list(bound)], sure[list(bound)] = True, 1.0
    return np.where(keep, labels, UNKNOWN), sure


def seen_together(tracklets: Tracklets) -> np.ndarray:
    """Return a (C, C) mask of chains with tracklets that are visible at the same time."""
    first, last, chain = tracklets.first, tracklets.last, tracklets.chain
    together = np.zeros((tracklets.num_chains,) * 2, dtype=bool)
    for start in range(0, len(first), _ROWS):
        rows = slice(start, start + _ROWS)
        a, b = np.nonzero((first[rows, None] <= last) & (first <= last[rows, None]))
        together[chain[rows][a], chain[b]] = True
    np.fill_diagonal(together, False)
    return together


AROUND = tuple(MARKERS.index(name) for name in ("LFHD", "RFHD", "RBHD", "LBHD"))  # The head's markers in cyclic order.
_PAIRS = tuple((MARKERS.index("L" + name), MARKERS.index("R" + name)) for name in ("SHO", "FWT", "BWT"))
SIDEWAYS = np.radians(70.0)
"""Smallest mean head rotation relative to shoulders and waist that reveals wrong names. In 158 takes from UI-PRMD the
largest is 43 degrees, and in 28 other files 56. Names that are off by a quarter turn add 90."""
LEAST_FRAMES = 10  # Smallest number of frames that show all four markers.


def with_head_forward(
    positions: np.ndarray, tracklets: Tracklets, labels: np.ndarray, bound: dict[int, int]
) -> np.ndarray:
    """Return each chain's label. If the head faces sideways, the labels of its markers are shifted by quarter turns.

    If a head is wider than long, the distances between its markers also fit after a quarter turn. If the user assigned
    a label of the head (``bound``, by chain), no label changes.
    """
    if any(label in AROUND for label in bound.values()):
        return labels
    tracks = {m: _track(positions, tracklets, labels, m) for m in (*AROUND, *(m for pair in _PAIRS for m in pair))}
    left = [tracks[a] - tracks[b] for a, b in _PAIRS if (np.isfinite(tracks[a] - tracks[b])).any()]
    head = np.stack([tracks[m] for m in AROUND], axis=1)
    if not left:
        return labels
    turns = [_turn(np.roll(head, quarter, axis=1), left) for quarter in range(4)]
    best = int(np.argmin(np.abs(turns)))
    if not abs(turns[0]) > SIDEWAYS:
        return labels
    found = labels.copy()
    for place, marker in enumerate(AROUND):
        found[labels == marker] = AROUND[(place + best) % 4]
    return found


def _track(positions: np.ndarray, tracklets: Tracklets, labels: np.ndarray, marker: int) -> np.ndarray:
    number = tracklets.number
    mine = (number >= 0) & (labels[tracklets.chain[number]] == marker)
    track = np.full((len(positions), 3), np.nan)
    frames, columns = np.nonzero(mine)
    track[frames] = positions[frames, columns]
    return track


def _turn(head: np.ndarray, left: list[np.ndarray]) -> float:
    """Return the mean angle in radians from the head's left to the body's left, or 0 if unknown.

    The (F, 4, 3) markers are in the order of ``AROUND``. ``left`` are (F, 3) vectors from the body's right to its left.
    """
    lf, rf, rb, lb = np.moveaxis(head, 1, 0)
    own_left, front = unit(lf + lb - rf - rb), unit(lf + rf - lb - rb)
    body = unit(np.nansum([unit(side) for side in left], axis=0))
    along, across = (own_left * body).sum(-1), (front * body).sum(-1)
    there = np.isfinite(along) & np.isfinite(across)
    if there.sum() < LEAST_FRAMES:
        return 0.0
    return float(np.arctan2(across[there].mean(), along[there].mean()))


CHECK_FPS = 8.0  # Frames per second at which a body is fitted.
SIGMA_M, FREEDOM = 0.03, 3.0
"""Standard deviation per axis (m) of a marker on an uncalibrated body, and degrees of freedom of Student's
t-distribution for these distances. If a limb is posed wrongly, all its distances are wrong."""
GHOST_M, _FARTHEST_M = 0.12, 0.2
"""Distance (m) from all markers at which a point is as likely not a marker, and largest distance that counts."""
GUESS_WIDER, STEPS = 3.0, 5  # Factor applied to the network's deviation of uncertain markers, and steps per frame.
BAD_FIT_M = 0.06
"""Largest median distance in metres from a body to all markers, or to a limb's markers. Worse fits are not used."""
_FEWEST = 12  # Smallest number of certain markers in a frame.


class FittedBody(Protocol):
    """Body that was fitted to the markers in one frame."""

    @property
    def landmarks(self) -> np.ndarray:
        """(53, 3) marker positions on the body in metres."""
        ...

    @property
    def off_m(self) -> float:
        """Median distance between the body and the visible markers in metres, or NaN if none is visible."""
        ...


class BodyFit(Protocol):
    """Interface for fitting a body to the markers frame by frame."""

    def restart(self) -> None:
        """Forget the pose of the previous frame."""
        ...

    def step(
        self, points: np.ndarray, guess: np.ndarray, guess_sigma: np.ndarray, dt: float, steps: int | None = None
    ) -> FittedBody:
        """Fit the body to one frame of markers (53, 3). Hidden markers are replaced by ``guess``.

        ``guess`` (53, 3) has the standard deviations ``guess_sigma`` (53,) in metres. ``dt`` is the time since the last
        frame in seconds. ``steps`` is the smallest number of Gauss-Newton steps, or None for the default.
        """
        ...


def body_evidence(
    positions: np.ndarray,
    tracklets: Tracklets,
    votes: Votes,
    labels: np.ndarray,
    trusted: np.ndarray,
    fps: float,
    fit: BodyFit,
) -> np.ndarray:
    """Return the log likelihoods (C, 54) of each chain's labels, from its mean distances to a fitted body's markers.

    The body is fitted to the chains in the mask ``trusted`` (C,). ``fit`` must be new or restarted. Chains that are
    never visible in a frame with a good fit get 0.
    """
    frames, guesses = votes.frames, votes.landmarks[:, :GHOST]
    sigmas = np.sqrt(np.trace(votes.covariance[:, :GHOST], axis1=-2, axis2=-1) / 3.0)
    step = max(1, round(fps / CHECK_FPS / max(1.0, float(np.median(np.diff(frames))) if len(frames) > 1 else 1.0)))
    body, chains = load_body(), tracklets.num_chains
    moved = _moved_with(marker_landmarks(body, MARKERS).weights, body.parents)
    total, count, before = np.zeros((chains, GHOST)), np.zeros(chains), -1
    for row in range(0, len(frames), step):
        frame = int(frames[row])
        columns = np.flatnonzero(tracklets.number[frame] >= 0)
        chain = tracklets.chain[tracklets.number[frame, columns]]
        sure = trusted[chain] & (labels[chain] < GHOST)
        if sure.sum() < _FEWEST:
            continue
        markers = np.full((len(MARKERS), 3), np.nan)
        markers[labels[chain[sure]]] = positions[frame, columns[sure]]
        dt = 0.2 if before < 0 else min((frame - before) / fps, 0.5)
        if before < 0 or (frame - before) / fps > 1.0:
            fit.restart()
        found = fit.step(markers, guesses[row], GUESS_WIDER * sigmas[row], dt, STEPS)
        before = frame
        if not found.off_m < BAD_FIT_M:
            before = -1
            continue
        apart = np.linalg.norm(positions[frame, columns][:, None] - found.landmarks, axis=-1)
        apart = np.where(_limbs_fit(markers, found.landmarks, moved), apart, GHOST_M)
        np.add.at(total, chain, np.minimum(apart, _FARTHEST_M))
        np.add.at(count, chain, 1.0)
    distance = np.where(count[:, None] > 0, total / np.maximum(count, 1.0)[:, None], np.nan)
    far = np.concatenate([distance, np.full((chains, 1), GHOST_M)], axis=1)
    log = -0.5 * (FREEDOM + 1.0) * np.log1p((np.nan_to_num(far) / SIGMA_M) ** 2 / FREEDOM)
    return np.where(count[:, None] > 0, log, 0.0)


def _moved_with(weights: np.ndarray, parents: tuple[int, ...]) -> np.ndarray:
    """Return a (53, 53) mask. Entry (i, j) is true if marker j is on the joint of marker i or on a joint below it."""
    within = np.eye(len(parents), dtype=bool)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            within[:, joint] |= within[:, parent]
    hangs_on = weights.argmax(axis=1)
    return within[hangs_on][:, hangs_on]


def _limbs_fit(markers: np.ndarray, places: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Return a (53,) mask that is true for markers on a limb that fits the body.

    The limb consists of the marker's joint and all joints below it. The mask excludes wrists with a marker bar, where
    the fitted body mistakes one end of the bar for the hand.
    """
    squared = ((markers - places) ** 2).sum(axis=-1)
    laid = moved & np.isfinite(squared)
    mean = (laid * np.nan_to_num(squared)).sum(axis=1) / np.maximum(laid.sum(axis=1), 1)
    return mean < BAD_FIT_M**2


READ_FPS = 30.0  # Frames per second that the network reads. Closer readings repeat each other.
CROWD = 200
"""Largest number of points per frame for which the network reads ``READ_FPS`` frames per second. With more points, it
reads the same number of pairs per second: 1.3 s of CPU per second of a take. Chosen by hand, above one person."""
ROUNDS, BODY_FROM = 5, 2  # Voting rounds that use the previous round's names, and the first round with a body.
_FLOOR = -8.0  # Smallest log probability of one reading, so that no single frame excludes a label.
MOST_CHAINS = 5000  # Largest number of tracklet chains. With this number, comparing every pair needs 2 GB.


@dataclass(frozen=True)
class LabelledTake:
    """Labels of N points in F frames, and of their tracklets."""

    labels: np.ndarray  # (F, N) marker of each point, ``GHOST`` for no marker, -1 if unknown or missing.
    confidence: np.ndarray  # (F, N) probability of the label, NaN if there is no point.
    tracklets: Tracklets
    stretch_label: np.ndarray  # (T,) label of each tracklet.
    stretch_confidence: np.ndarray  # (T,) probability of that label.
    votes: Votes  # The network's readings that the labels are based on.

    def cloud(self, source: MarkerCloud) -> MarkerCloud:
        """Return the take with one column per marker in the superset's order, followed by the unnamed points.

        Names set by the user do not change, and other points are numbered. If two tracklets in a frame have the same
        marker, the more certain one counts.
        """
        frames, given = len(self.labels), source.values
        named = sorted(set(self.labels[(self.labels >= 0) & (self.labels < GHOST)].tolist()))
        values = np.full((frames, len(named), given.shape[-1]), np.nan)
        for column, label in enumerate(named):
            mine = np.where(self.labels == label, self.confidence, -1.0)
            best = mine.argmax(1)
            there = mine[np.arange(frames), best] >= 0
            values[there, column] = given[there, best[there]]
        rest = np.where(((self.labels < 0) | (self.labels == GHOST))[..., None], given, np.nan)
        kept = np.flatnonzero(np.isfinite(rest[..., :3]).all(-1).any(0))
        markers = tuple(MARKERS[label] for label in named)
        own = [(source.labels or ("",) * given.shape[1])[column] for column in kept]
        names = (*markers, *(f"*{i}" if is_unnamed(x) or x in markers else x for i, x in enumerate(own, start=1)))
        return source.with_values(np.concatenate([values, rest[:, kept]], axis=1), names)


def label_take(
    cloud: MarkerCloud,
    network: LandmarkNetwork,
    start_fit: Callable[[], BodyFit],
    progress: Progress = silent,
    user_labels: Mapping[tuple[int, int], str] | None = None,
    *,
    persistent: bool = False,
) -> LabelledTake:
    """Label the points in a take with the landmark network.

    Columns in the cloud (metres, Z up) are tracks, which may break, jump, and continue in another column.

    Args:
        start_fit: creates a fit of a body to the labelled points.
        user_labels: marker name by (column, frame), valid for the whole tracklet. Empty text means no marker.
        persistent: each column is one marker throughout the take.

    Raises:
        NoDetections: no frame has enough points.
        CaptureInvalid: there are too many points to compare.
    """
    positions, fps = np.asarray(cloud.positions, dtype=np.float64), cloud.fps
    seen = np.isfinite(positions).all(-1)
    require_points(seen)
    tracklets = tracklets_of(positions, fps, persistent=persistent)
    require_at_most(MOST_CHAINS, tracklets.num_chains, "track segments")
    votes = _read(positions, seen, _frames_to_read(seen, tracklets, fps), tracklets, network, progress)
    bound = {
        int(tracklets.chain[stretch]): MARKERS.index(name) if name in MARKERS else GHOST
        for (column, frame), name in (user_labels or {}).items()
        if (stretch := tracklets.number[frame, column]) >= 0
    }
    # First, only the network votes. Then distances to the labelled chains and a fitted body are used as well.
    together, table, by_body = seen_together(tracklets), load_distances(), np.zeros(votes.evidence.shape)
    distances = distances_of(positions, votes.frames, tracklets, fps)
    labels, sure = voted(votes, together, fps, bound, by_body, by_body)
    for turn in range(ROUNDS):
        progress("Naming the points", turn, ROUNDS)
        agreed = votes.mean[np.arange(len(labels)), labels]
        trusted = (labels >= 0) & (sure >= TRUSTED) & ((agreed >= FIRST_AGREED) | (turn > 0))
        trusted[list(bound)] = True
        by_distance = distance_evidence(distances, labels, trusted, table)
        if turn >= BODY_FROM:
            laid = trusted & (agreed >= AGREED)
            laid[list(bound)] = True
            by_body = body_evidence(positions, tracklets, votes, labels, laid, fps, start_fit())
        labels, sure = voted(votes, together, fps, bound, by_distance, by_body)
    progress("Naming the points", ROUNDS, ROUNDS)
    labels = with_head_forward(positions, tracklets, labels, bound)
    labels, sure = labels[tracklets.chain], sure[tracklets.chain]
    stretch = tracklets.number
    by_point = np.where(stretch >= 0, labels[stretch], UNKNOWN)
    confidence = np.where(stretch >= 0, sure[stretch], np.nan)
    return LabelledTake(by_point, confidence, tracklets, labels, sure, votes)


def _frames_to_read(seen: np.ndarray, tracklets: Tracklets, fps: float) -> np.ndarray:
    """Return the frames for the network: at the reading rate, and at least one from every tracklet.

    Frames need enough visible points. If they have many points, fewer frames are used (see ``CROWD``).
    """
    pairs = float(np.square(seen.sum(1), dtype=np.float64).mean()) / CROWD**2
    step = max(1, round(fps / READ_FPS * max(1.0, pairs)))
    frames = np.arange(0, len(seen), step)
    spans = np.searchsorted(frames, np.stack([tracklets.first, tracklets.last + 1]))
    missed = spans[0] == spans[1]
    first, last = tracklets.first[missed], tracklets.last[missed]
    frames = np.union1d(frames, (first + last) // 2 if pairs <= 1.0 else _fewest_inside(first, last))
    enough = seen.sum(1) >= FEWEST_POINTS
    return frames[enough[frames]] if enough[frames].any() else np.flatnonzero(enough)


def _fewest_inside(first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the smallest set of frames that includes a frame from every tracklet."""
    chosen, latest = list[int](), -1
    for t in np.argsort(last, kind="stable"):
        if first[t] > latest:
            latest = int(last[t])
            chosen.append(latest)
    return np.array(chosen, dtype=int)


def _read(
    positions: np.ndarray,
    seen: np.ndarray,
    frames: np.ndarray,
    tracklets: Tracklets,
    network: LandmarkNetwork,
    progress: Progress,
) -> Votes:
    chains = tracklets.num_chains
    evidence, mean, count = np.zeros((chains, GHOST + 1)), np.zeros((chains, GHOST + 1)), np.zeros(chains)
    landmarks = np.zeros((len(frames), len(LANDMARKS), 3))
    covariance = np.zeros((len(frames), len(LANDMARKS), 3, 3))
    done = 0
    for part in read_frames(positions, seen, frames, network):
        here = slice(done, done + len(part.frames))
        which = tracklets.chain[np.take_along_axis(tracklets.number[part.frames], part.columns, axis=1)[part.there]]
        log = part.reading.log_probability[part.there]
        np.add.at(evidence, which, np.maximum(log, _FLOOR))
        np.add.at(mean, which, np.exp(log))
        np.add.at(count, which, 1.0)
        landmarks[here], covariance[here], done = part.reading.positions, part.reading.covariance, here.stop
        progress("Reading the points", done, len(frames))
    return Votes(frames, landmarks, covariance, evidence, mean / np.maximum(count, 1.0)[:, None], count)
