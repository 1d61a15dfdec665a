"""A cloud without names gets them: the network reads frames, stretches vote, labels exclude one another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.body.marker_names import is_unnamed
from solver_backend.exchange.progress import Progress, silent
from solver_backend.labelling.body_check import BodyFit, body_evidence
from solver_backend.labelling.frame_landmarks import FEWEST_POINTS, read_frames, require_at_most, require_points
from solver_backend.labelling.head_turn import with_head_forward
from solver_backend.labelling.marker_distances import distance_evidence, distances_of, load_distances
from solver_backend.labelling.outputs import GHOST, JOINTS, LANDMARKS, MARKERS
from solver_backend.labelling.point_network import PointNetwork
from solver_backend.labelling.tracklets import Tracklets, tracklets_of
from solver_backend.labelling.voting import AGREED, FIRST_AGREED, TRUSTED, UNKNOWN, Votes, seen_together, voted
from solver_backend.types import MarkerCloud

READ_FPS = 30.0
"""Frames a second that the network reads: votes nearer to each other repeat each other."""
CROWD = 200
"""Points of a frame up to which the network reads ``READ_FPS`` frames a second, and of more as many pairs of points a
second: 1.3 s of CPU for a second of a take. Chosen by hand, beyond what one person's cameras see."""
ROUNDS, BODY_FROM = 5, 2
"""Times that all is voted again with what the last vote named, and the first of them that a body is laid over."""
_FLOOR = -8.0
"""Least log probability that one reading may have: no single frame rules a label out."""
MOST_CHAINS = 5000
"""Chains of stretches: every pair of them is compared, 2 GB at this number."""


@dataclass(frozen=True)
class LabelledTake:
    """F frames of N points and what each of them is."""

    labels: np.ndarray
    """(F, N) marker of each point, ``GHOST`` for none of them, -1 unknown or not there."""
    confidence: np.ndarray
    """(F, N) probability of the label, NaN where there is no point."""
    tracklets: Tracklets
    stretch_label: np.ndarray
    """(T,) label of each stretch, as above."""
    stretch_confidence: np.ndarray
    """(T,)"""
    frames: np.ndarray
    """(K,) frames that the network read."""
    landmarks: np.ndarray
    """(K, 77, 3) metres: where the network has markers and joints."""
    covariance: np.ndarray
    """(K, 77, 3, 3) m²."""

    @property
    def joints(self) -> np.ndarray:
        """(K, 24, 3) metres."""
        return self.landmarks[:, -len(JOINTS) :]

    def cloud(self, source: MarkerCloud) -> MarkerCloud:
        """Return the take with one column a marker, by the superset's order, and the points without a place after them.

        Names that somebody gave these stay; others are numbered. Where two stretches of one marker share a frame, the
        surer one counts.
        """
        frames = len(self.labels)
        named = sorted(set(self.labels[(self.labels >= 0) & (self.labels < GHOST)].tolist()))
        # What is known of a point's error goes with it, as further coordinates.
        parts = [source.positions]
        if source.residual is not None:
            parts.append(source.residual[..., None])
        if source.covariance is not None:
            parts.append(source.covariance.reshape(*source.positions.shape[:2], 9))
        given = np.concatenate(parts, axis=-1)
        values = np.full((frames, len(named), given.shape[-1]), np.nan)
        for column, label in enumerate(named):
            mine = np.where(self.labels == label, self.confidence, -1.0)
            best = mine.argmax(1)
            there = mine[np.arange(frames), best] >= 0
            values[there, column] = given[there, best[there]]
        rest = np.where(((self.labels < 0) | (self.labels == GHOST))[..., None], given, np.nan)
        kept = np.flatnonzero(np.isfinite(rest[..., :3]).all(-1).any(0))
        rest = rest[:, kept]
        values = np.concatenate([values, rest], axis=1)
        residual = None if source.residual is None else values[..., 3]
        covariance = None if source.covariance is None else values[..., -9:].reshape(*values.shape[:2], 3, 3)
        markers = tuple(MARKERS[label] for label in named)
        own = [(source.labels or ("",) * given.shape[1])[column] for column in kept]
        names = (*markers, *(f"*{i}" if is_unnamed(x) or x in markers else x for i, x in enumerate(own, start=1)))
        return replace(source, positions=values[..., :3], labels=names, residual=residual, covariance=covariance)


def label_take(
    cloud: MarkerCloud, network: PointNetwork, start_fit: Callable[[], BodyFit], progress: Progress = silent,
    user_labels: Mapping[tuple[int, int], str] | None = None, *, persistent: bool = False,
) -> LabelledTake:  # fmt: skip
    """Label the points of a take.

    Args:
        cloud: points, Z up, metres; columns are tracks, which may break, jump, and go on elsewhere.
        network: that reads frames.
        start_fit: makes the fit of a body that is laid over what was named.
        progress: called as frames are read and points are named.
        user_labels: marker's name by (column, frame), assigned by the user: it holds for the whole stretch.
            Empty text: none of them.
        persistent: each column is one marker throughout the take.

    Raises:
        NoDetections: in no frame are there enough points.
        CaptureInvalid: there are more points than can be compared with one another.
    """
    positions = np.asarray(cloud.positions, dtype=np.float64)
    seen = np.isfinite(positions).all(-1)
    require_points(seen)
    tracklets = tracklets_of(positions, cloud.fps, persistent=persistent)
    require_at_most(MOST_CHAINS, tracklets.num_chains, "stretches of points")
    frames = _frames_to_read(seen, tracklets, cloud.fps)
    votes, landmarks, covariance = _read(positions, seen, frames, tracklets, network, progress)
    bound = _bound(user_labels or {}, tracklets)
    labels, sure = _named(positions, tracklets, votes, landmarks, covariance, cloud.fps, bound, start_fit, progress)
    labels = with_head_forward(positions, tracklets, labels, bound)
    labels, sure = labels[tracklets.chain], sure[tracklets.chain]
    stretch = tracklets.number
    by_point = np.where(stretch >= 0, labels[stretch], UNKNOWN)
    confidence = np.where(stretch >= 0, sure[stretch], np.nan)
    return LabelledTake(by_point, confidence, tracklets, labels, sure, frames, landmarks, covariance)


def _frames_to_read(seen: np.ndarray, tracklets: Tracklets, fps: float) -> np.ndarray:
    """Return frames at the reading rate, and one in each stretch too short to have one, where enough is seen.

    A crowd is read less often, see ``CROWD``, and in as few frames as its short stretches allow.
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
    """Return the fewest frames of which one is inside each stretch: ends of those that end before others begin."""
    chosen, latest = list[int](), -1
    for t in np.argsort(last, kind="stable"):
        if first[t] > latest:
            latest = int(last[t])
            chosen.append(latest)
    return np.array(chosen, dtype=int)


def _read(
    positions: np.ndarray, seen: np.ndarray, frames: np.ndarray, tracklets: Tracklets, network: PointNetwork,
    progress: Progress,
) -> tuple[Votes, np.ndarray, np.ndarray]:  # fmt: skip
    """Return the votes on the chains, and the frames' landmarks with their covariances."""
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
    return Votes(frames, evidence, mean / np.maximum(count, 1.0)[:, None], count), landmarks, covariance


def _bound(given: Mapping[tuple[int, int], str], tracklets: Tracklets) -> dict[int, int]:
    """Return the label of each chain that the user assigned one."""
    found = {}
    for (column, frame), name in given.items():
        stretch = tracklets.number[frame, column]
        if stretch >= 0:
            found[int(tracklets.chain[stretch])] = MARKERS.index(name) if name in MARKERS else GHOST
    return found


def _named(
    positions: np.ndarray, tracklets: Tracklets, votes: Votes, landmarks: np.ndarray, covariance: np.ndarray,
    fps: float, bound: dict[int, int], start_fit: Callable[[], BodyFit], progress: Progress,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return label and confidence of every chain: voted, and again with distances and a body among what was named."""
    spread = np.sqrt(np.trace(covariance[:, :GHOST], axis1=-2, axis2=-1) / 3.0)
    together, table = seen_together(tracklets), load_distances()
    distances = distances_of(positions, votes.frames, tracklets, fps)
    labels, sure = voted(votes, together, fps, bound)
    by_body = None
    for turn in range(ROUNDS):
        progress("Naming the points", turn, ROUNDS)
        agreed = votes.mean[np.arange(len(labels)), labels]
        trusted = (labels >= 0) & (sure >= TRUSTED) & ((agreed >= FIRST_AGREED) | (turn > 0))
        trusted[list(bound)] = True
        by_distance = distance_evidence(distances, labels, trusted, table)
        if turn >= BODY_FROM:
            laid = trusted & (agreed >= AGREED)
            laid[list(bound)] = True
            by_body = body_evidence(
                positions, votes.frames, landmarks[:, :GHOST], spread, tracklets, labels, laid, fps, start_fit()
            )  # fmt: skip
        labels, sure = voted(votes, together, fps, bound, by_distance, by_body)
    progress("Naming the points", ROUNDS, ROUNDS)
    return labels, sure
