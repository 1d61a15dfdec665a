"""Fit one person to the keypoints from several live cameras."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import sentence
from solver_backend.exchange.events import EventLine, FrameLine, LiveLine
from solver_backend.exchange.reading_settings import WorldSettings
from solver_backend.fitters.model.subject import PosedFrames, pose
from solver_backend.fitters.recipes.live import FEWEST, UPRIGHT, LiveViewsFit, ViewsFrame
from solver_backend.io.recognition.world_fit import fit_world
from solver_backend.live.frames import ViewMoment
from solver_backend.live.session import LOST_S, SessionLoop, doubts_of, event, keypoint_limbs, pose_of
from solver_backend.types import Cameras, JointSet, Keypoints2D

CLEARLY = 0.5  # Limb pairs are swapped if that reduces their distance to at most this fraction.
FAR = 0.08  # Pairs whose distance is below this fraction of the person's size are never swapped, as limbs may cross.
_PARTS = {
    "arms": ("shoulder", "elbow", "wrist", "thumb", "index", "pinky"),
    "legs": ("hip", "knee", "ankle", "heel", "big_toe", "small_toe", "foot_index"),
    "head": ("eye", "eye_inner", "eye_outer", "ear", "mouth"),
}
_FEWEST = 2  # Minimum number of visible keypoints in a pair that can be swapped.


class ExchangedSides:
    """Correction for limbs that the detector swapped between left and right."""

    def __init__(self, names: Sequence[str]) -> None:
        rows = {name: row for row, name in enumerate(names)}
        self._pairs: list[tuple[np.ndarray, np.ndarray]] = []
        for parts in _PARTS.values():
            there = [part for part in parts if f"left_{part}" in rows and f"right_{part}" in rows]
            sides = [[rows[f"{side}_{part}"] for part in there] for side in ("left", "right")]
            own, other = [*sides[0], *sides[1]], [*sides[1], *sides[0]]
            if there:
                self._pairs.append((np.array(own), np.array(other)))

    def put_back(self, seen: np.ndarray, expected: np.ndarray) -> tuple[np.ndarray, int]:
        """Correct swapped sides in one view's (K, 3) keypoints. Return the keypoints and the number of corrected pairs.

        Keypoints are x, y and confidence, with NaN or a confidence of 0 where missing. ``expected`` contains the (K, 2)
        pixels of the person's last pose, NaN where unknown.
        """
        size = float(np.linalg.norm(np.nanmax(expected, axis=0) - np.nanmin(expected, axis=0)))
        found, count = seen.copy(), 0
        for own, other in self._pairs:
            there = np.isfinite(seen[own]).all(-1) & (seen[own, 2] > 0)
            if there.sum() < _FEWEST:
                continue
            as_is, exchanged = (
                np.nanmedian(np.linalg.norm(seen[own[there], :2] - expected[to[there]], axis=-1)) for to in (own, other)
            )
            if as_is > FAR * size and exchanged < CLEARLY * as_is:
                found[other] = seen[own]
                count += 1
        return found, count


WORLD_MOMENTS = 12  # Number of moments with a person from which up axis and floor are determined before the first pose.
BAD_M = 0.12  # Largest median distance from keypoints to the body in a good pose, in metres. Detectors differ by 3 cm.
STARTS_WITH = 0.8  # Smallest fraction of common keypoints on which two views must agree at the start.
_TRIAL_MOMENTS = 6  # Number of moments that are processed to warm up all parts.
SAME_PERSON = 0.5  # Largest median distance to the person's detection, relative to the person's size in the image.


class ViewsSession(SessionLoop[ViewMoment, LiveViewsFit]):
    """Live session that fits one person to the views of several cameras."""

    def __init__(
        self,
        cameras: Cameras,
        joint_set: JointSet,
        betas: np.ndarray | None = None,
        world: WorldSettings = WorldSettings(),
        up_axis: str | None = None,
    ) -> None:
        """Create a session. The cameras move to the person's world as soon as its floor and up axis are known.

        ``betas`` (10,) is the shape of a known person. ``up_axis`` is the calibration's up axis. If it is None, the up
        axis is Z or the axis along which the person stands.
        """
        super().__init__(LiveViewsFit(load_body(), cameras, joint_set, betas))
        self.cameras, self.joint_set, self.world, self.up_axis = cameras, joint_set, world, up_axis
        self._first: list[tuple[np.ndarray, np.ndarray]] = []
        self._limbs = keypoint_limbs(joint_set.keypoints)
        self._good, self._world_known = float("-inf"), False
        self._expected: np.ndarray | None = None
        self._may_start_anew = True
        self._sides = ExchangedSides(joint_set.keypoints)
        self.sides_put_back = 0
        """Number of limb pairs with corrected sides."""
        self.chosen: tuple[np.ndarray, np.ndarray] | None = None
        """(C, K, 2) pixels and (C, K) confidences of the person at the last moment."""

    def warm_up(self) -> None:
        """Fit a standing body several times and discard the results, so that the first real moment is not late."""
        trial = LiveViewsFit(self.fit.subject.body, self.cameras, self.joint_set)
        standing = PosedFrames(UPRIGHT[None], trial.rest, _middle(self.cameras)[None])
        xy = project(self.cameras, pose(trial.subject, standing).points)[:, 0]
        sure = np.isfinite(xy).all(-1).astype(np.float64)
        for _ in range(_TRIAL_MOMENTS):
            trial.step(xy, sure, trial.locate(xy, sure), 1.0 / 30.0)
        trial.deviations()

    def _lines(self, moment: ViewMoment, dt: float) -> Iterator[LiveLine]:
        self.chosen = None
        self.chosen = xy, confidence = self._person(moment)
        located = self.fit.locate(xy, confidence)
        points = np.asarray(located.points)[0]
        seen = np.isfinite(points).all(-1)
        if seen.sum() < FEWEST:
            self.shown, self.shown_off_m = points[seen], np.full(int(seen.sum()), np.nan)
            why = f"two views agree on only {int(seen.sum())} keypoints"
            yield self._nothing(moment, why, "no_person")
            return
        if self.fit.pose is None:
            self._good = moment.time  # a new start is given as much time as a lost pose
            share = seen.sum() / max(int(((confidence > 0).sum(0) >= 2).sum()), 1)
            if share < STARTS_WITH:
                why = f"the views agree on {share:.0%} of their keypoints, so sides may be swapped in one view"
                yield self._nothing(moment, why, "no_person")
                return
        if not self._world_known:
            self._first.append((xy, confidence))
            if len(self._first) < WORLD_MOMENTS:
                yield self._nothing(moment, "estimating floor and up axis", "waiting")
                return
            yield from self._enter_world(moment)
            located = self.fit.locate(xy, confidence)
        yield self._fitted(moment, self.fit.step(xy, confidence, located, dt))

    def _fitted(self, moment: ViewMoment, found: ViewsFrame) -> FrameLine:
        seen = np.isfinite(found.points_off_m)
        self.shown, self.shown_off_m = found.points[seen], found.points_off_m[seen]
        self._expected = found.landmarks
        off_m = float(np.median(self.shown_off_m))
        doubts = doubts_of(found.points_off_m, 0, self._limbs)
        if doubts and self.fit.is_starting and self._may_start_anew:
            # After a start, an arm can be wrong for about a second. Another start may avoid this.
            self._may_start_anew = False
            self.fit.restart()
            return self._nothing(moment, f"starting again: {doubts}", "waiting")
        if off_m < BAD_M:
            self._good = moment.time
        elif moment.time - self._good > LOST_S:
            self._reset()
        state = "tracking" if off_m < BAD_M and not doubts else "unsure"
        counts = {"points": int(seen.sum()), "views": _views(moment), "off_mm": round(1e3 * off_m, 2)}
        return self._line(moment, state, doubts, **pose_of(found.pose), **counts)

    def _person(self, moment: ViewMoment) -> tuple[np.ndarray, np.ndarray]:
        """Return the person's (C, K, 2) pixels and (C, K) confidences, missing in views that do not show the person.

        Compared with the last pose, limbs may look swapped between left and right. They are swapped back only if more
        keypoints then agree between views, because the last pose may be wrong.
        """
        K, count = self.joint_set.num_keypoints, len(self.cameras.names)
        seen = np.full((count, K, 3), np.nan)
        expected = None if self._expected is None else project(self.cameras, self._expected[None])[:, 0]
        for c, people in enumerate(moment.people):
            if people is not None and len(people):
                found = _nearest(people[:, :K], None if expected is None else expected[c])
                seen[c] = seen[c] if found is None else found
        for c, places in enumerate(() if expected is None else expected):
            put_back, pairs = self._sides.put_back(seen[c], places)
            other = np.concatenate([seen[:c], put_back[None], seen[c + 1 :]])
            if pairs and self._agreement(other) > self._agreement(seen):
                seen, self.sides_put_back = other, self.sides_put_back + pairs
        return _split(seen)

    def _agreement(self, seen: np.ndarray) -> int:
        """Return how many keypoints in ``seen`` (C, K, 3) at least two views locate consistently."""
        return int(np.isfinite(np.asarray(self.fit.locate(*_split(seen)).points)).all(-1).sum())

    def _enter_world(self, moment: ViewMoment) -> Iterator[EventLine]:
        xy, confidence = (np.stack(part, axis=1) for part in zip(*self._first, strict=True))
        self._world_known, self._first = True, []
        keypoints = Keypoints2D(xy, confidence, self.joint_set, 1.0 / 0.1)
        fitted = fit_world(self.cameras, keypoints, self.world, self.up_axis)
        self.cameras = self.fit.cameras = fitted.cameras
        for found in fitted.found:
            yield event("world", sentence(found), moment.time)

    def _reset(self) -> None:
        self.fit.restart()
        self._expected, self._good, self._may_start_anew = None, float("-inf"), True

    def _nothing(self, moment: ViewMoment, why: str, state: str) -> FrameLine:
        points = 0 if self.shown is None else len(self.shown)
        return self._line(moment, state, why, points=points, views=_views(moment))


def _split(seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split (..., 3) keypoints into pixels and confidences. If either value is missing, both are set to missing."""
    there = np.isfinite(seen).all(-1) & (seen[..., 2] > 0)
    return np.where(there[..., None], seen[..., :2], np.nan), np.where(there, np.minimum(seen[..., 2], 1.0), 0.0)


def _nearest(people: np.ndarray, expected: np.ndarray | None) -> np.ndarray | None:
    """Return the keypoints of the person near ``expected`` (K, 2), or of the largest person if that is None.

    Return None if there is no such person.
    """
    shown, confidence = _split(people)
    known = np.isfinite(shown).all(-1).any(axis=1)
    if not known.any():
        return None
    people, shown, confidence = people[known], shown[known], confidence[known]
    size = np.hypot(*(np.nanmax(shown, axis=1) - np.nanmin(shown, axis=1)).T)
    if expected is None:
        return people[np.argmax(size * confidence.mean(1))]
    off = np.nanmedian(np.linalg.norm(shown - expected, axis=-1), axis=1)
    best = int(np.argmin(off))
    return people[best] if off[best] < SAME_PERSON * size[best] else None


def _middle(cameras: Cameras) -> np.ndarray:
    """Return the (3,) point x closest to all optical axes d through c: ``min Σ |(I - d dᵀ)(x - c)|²``."""
    d = cameras.R[:, 2]
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    centres = -np.einsum("cij,ci->cj", cameras.R, cameras.t)
    return np.linalg.lstsq(across.sum(0), np.einsum("cij,cj->i", across, centres), rcond=None)[0]


def _views(moment: ViewMoment) -> int:
    return sum(people is not None for people in moment.people)
