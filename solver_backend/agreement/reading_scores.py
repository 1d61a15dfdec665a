"""How well views agree if their calibration is read in one way or another, each pair of cameras computed once."""

from __future__ import annotations

from collections.abc import Container, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from solver_backend.agreement.detections import MIN_CONFIDENCE
from solver_backend.agreement.pair_agreement import OFF_LINE, pair_agreement, pair_agreements
from solver_backend.cameras.camera_corrections import CameraCorrection, corrected
from solver_backend.cameras.camera_pairs import compared_pairs
from solver_backend.cameras.projection import undistort
from solver_backend.types import Cameras

CHANGE_COST = 0.01
"""Share that a reading must gain for each thing that it changes."""
EACH = 8
"""Cameras up to which every pair counts and each may be read by itself. Of more, all are read alike, and each is
compared with so many around: the search must not grow with the square of an array of hundreds."""
PairReading = tuple[int, CameraCorrection, int, CameraCorrection]
"""Two cameras, and how each is read."""


View = tuple[np.ndarray, np.ndarray, np.ndarray]
"""(F, J, 2) normalised points of a camera, NaN where unseen, with its rotation and translation."""


class ReadingScores:
    """Agreement of readings; that of two cameras is computed once for each way to read them."""

    def __init__(self, cameras: Cameras, xy: np.ndarray, confidence: np.ndarray, off_line: float = OFF_LINE) -> None:
        self._off_line = off_line
        self.cameras, self._xy, self._seen = cameras, xy, confidence >= MIN_CONFIDENCE
        self._poses: dict[CameraCorrection, tuple[np.ndarray, np.ndarray]] = {}
        self._normalised: dict[CameraCorrection, np.ndarray] = {}
        self._compared = compared_pairs(len(cameras), EACH)
        self._pairs: dict[PairReading, float] = {}

    def on(self, count: int, cameras: list[int]) -> ReadingScores:
        """Return scores by fewer frames, and of these cameras."""
        rows = np.unique(np.linspace(0, self._xy.shape[1] - 1, count).astype(int))
        xy, seen = self._xy[cameras][:, rows], self._seen[cameras][:, rows]
        return ReadingScores(self.cameras.subset(cameras), xy, np.where(seen, 1.0, 0.0), self._off_line)

    def without(self, camera: int) -> ReadingScores:
        """Return scores by the pairs that a camera is no part of."""
        others = copy(self)
        others._compared = [pair for pair in self._compared if camera not in pair]
        return others

    def within(self, off_line: float) -> ReadingScores:
        """Return scores of keypoints that are so near their lines."""
        return ReadingScores(self.cameras, self._xy, np.where(self._seen, 1.0, 0.0), off_line)

    def of(self, reading: list[CameraCorrection]) -> float:
        """Return the mean share over the pairs of views that see the person together."""
        return self._mean(self._compared, reading)

    def penalised(self, reading: list[CameraCorrection]) -> float:
        """Return the same, less what its changes must be worth."""
        return self.of(reading) - CHANGE_COST * max(correction.changes for correction in reading)

    def of_sizes(self, reading: list[CameraCorrection], sizes: Sequence[float], chosen: Container[int]) -> np.ndarray:
        """Return (S,) what ``of`` returns of a reading in which pictures of chosen cameras have each of S sizes.

        Pictures ``s`` times as large as those calibrated are read as detections at ``(u + 0.5) / s - 0.5`` px, so all
        sizes are computed in one array; sizes that ``of`` rounds to whole pixels are not rounded here.
        """
        scores = np.full((len(self._compared), len(sizes)), np.nan)
        views = [self._sizes(c, r, sizes if c in chosen else (r.factor,)) for c, r in enumerate(reading)]
        for row, (a, b) in enumerate(self._compared):
            (x_a, R_a, t_a), (x_b, R_b, t_b) = views[a], views[b]
            count = max(len(x_a), len(x_b))
            x_a, x_b = (np.broadcast_to(x, (count, *x.shape[1:])) for x in (x_a, x_b))
            scores[row] = pair_agreements(x_a, R_a, t_a, x_b, R_b, t_b, self._off_line)
        known = np.isfinite(scores)
        return np.where(known, scores, 0.0).sum(0) / np.maximum(known.sum(0), 1)

    def _sizes(
        self, c: int, correction: CameraCorrection, sizes: Sequence[float]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (S, F, J, 2) normalised points of a camera whose pictures have each of S sizes, and its pose."""
        R, t = self._turned(_pose(correction))
        picture = CameraCorrection(turn=correction.turn, shape=correction.shape)
        one = corrected(self.cameras.subset([c]), [picture])
        factors = np.asarray(sizes)[:, None, None, None]
        xy = np.where(self._seen[c][..., None], (self._xy[c] + 0.5) / factors - 0.5, np.nan)
        flat = xy.reshape(1, -1, *xy.shape[2:])
        points = undistort(one, flat)
        return points.reshape(xy.shape), R[c], t[c]

    def compute(self, readings: Sequence[list[CameraCorrection]]) -> None:
        """Compute the pairs of several readings that are not known yet, those of the same poses in one array."""
        for a, b in self._compared:
            keys = dict.fromkeys((a, reading[a], b, reading[b]) for reading in readings)
            alike: dict[tuple[CameraCorrection, CameraCorrection], list[PairReading]] = {}
            for key in keys:
                if key not in self._pairs:
                    alike.setdefault((_pose(key[1]), _pose(key[3])), []).append(key)
            for group in alike.values():
                x_a = np.stack([self.view(a, key[1])[0] for key in group])
                x_b = np.stack([self.view(b, key[3])[0] for key in group])
                (_, R_a, t_a), (_, R_b, t_b) = self.view(a, group[0][1]), self.view(b, group[0][3])
                shares = pair_agreements(x_a, R_a, t_a, x_b, R_b, t_b, self._off_line)
                self._pairs.update(zip(group, shares.tolist(), strict=True))

    def of_camera(self, c: int, reading: list[CameraCorrection]) -> float:
        """Return the mean share of the pairs that one camera is part of."""
        return self._mean([pair for pair in self._compared if c in pair], reading)

    def _mean(self, pairs: list[tuple[int, int]], reading: list[CameraCorrection]) -> float:
        known = [share for a, b in pairs if np.isfinite(share := self._pair(a, b, reading))]
        return float(np.mean(known)) if known else 0.0

    def _pair(self, a: int, b: int, reading: list[CameraCorrection]) -> float:
        key = (a, reading[a], b, reading[b])
        if key not in self._pairs:
            self._pairs[key] = pair_agreement(*self.view(a, reading[a]), *self.view(b, reading[b]), self._off_line)
        return self._pairs[key]

    def of_pose(self, reading: list[CameraCorrection], c: int, R: np.ndarray, t: np.ndarray) -> float:
        """Return the same as ``of`` with another pose of one camera."""
        views = [self.view(k, r) for k, r in enumerate(reading)]
        views[c] = views[c][0], R, t
        shares = [
            pair_agreement(*views[a], *views[b], self._off_line) if c in (a, b) else self._pair(a, b, reading)
            for a, b in self._compared
        ]
        known = [share for share in shares if np.isfinite(share)]
        return float(np.mean(known)) if known else 0.0

    def within_picture(self, c: int, correction: CameraCorrection) -> float:
        """Return the share of a camera's keypoints that lie in its pictures as they are so read."""
        width, height = corrected(self.cameras.subset([c]), [correction]).image_size[0]
        u, v = self._xy[c][self._seen[c]].T
        return float(np.mean((u > -1) & (v > -1) & (u < width) & (v < height))) if len(u) else 0.0

    def view(self, c: int, correction: CameraCorrection) -> View:
        """Return points and pose of a camera so read."""
        points = self._points(CameraCorrection(correction.factor, correction.turn, shape=correction.shape))
        R, t = self._turned(_pose(correction))
        return points[c], R[c], t[c]

    def _turned(self, correction: CameraCorrection) -> tuple[np.ndarray, np.ndarray]:
        """Return (C, 3, 3) rotations and (C, 3) translations of all cameras so read; sizes of pictures change none."""
        if correction not in self._poses:
            all_alike = corrected(self.cameras, [correction] * len(self.cameras))
            self._poses[correction] = all_alike.R, all_alike.t
        return self._poses[correction]

    def _points(self, picture: CameraCorrection) -> np.ndarray:
        """Return (C, F, J, 2) normalised points of all cameras if their pictures are so read."""
        if picture not in self._normalised:
            all_alike = corrected(self.cameras, [picture] * len(self.cameras))
            xy = np.where(self._seen[..., None], self._xy, np.nan)
            self._normalised[picture] = undistort(all_alike, xy)
        return self._normalised[picture]


def _pose(correction: CameraCorrection) -> CameraCorrection:
    """Return the part of a correction that moves cameras; sizes and shapes of pictures do not."""
    return replace(correction, factor=1.0, shape="")
