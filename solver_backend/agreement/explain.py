"""Search the interpretation that explains a capture, and decide if it is certain."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, permutations
from math import perm

import numpy as np

from solver_backend.agreement.body_evidence import BodyEvidence, judge_body
from solver_backend.agreement.evidence import (
    BLOCKS,
    BOUND,
    LEAST_CAMERAS,
    UNRELATED_NOISE,
    Noise,
    TakeEvidence,
    density_per_bin,
)
from solver_backend.agreement.hypotheses import (
    CAMERA_ROWS,
    ROWS,
    Row,
    changes_of,
    conventions,
    cost_of,
    exchange_names,
    one_window,
    windows,
)
from solver_backend.agreement.picture_fit import FREE, fit_window
from solver_backend.agreement.reading import Detections, Reading
from solver_backend.types import Cameras

BEAM, MOST_FAULTS = 5, 2  # Readings that the search keeps, and faulty single cameras that it looks for.
MOVED_OF = 2  # Best readings that a moved camera is searched from. Each pose needs a fit.
JUDGED, SHORTLIST = 14, 28
"""Most likely readings that are triangulated, and that all poses rank. As few poses choose them from many."""
AS_NOISY = 1.15  # Largest noise ratio at which the simpler of two readings of one body wins.
AS_EXACT = 0.2
"""Most that the mean log density of a fitted view may lack, nats: a noise ratio of 1.2. Chosen between 48 simulated
moved cameras of eight tuning takes, which lack 0.18 at most, and 21 of 24 cameras of another take, which lack 0.23 and
more. The other three lack less than 0.2."""
AGREED_NOISE, AGREED_TIMES, AGREED_OUTLIERS = 0.035, 1.6, 0.15
"""Largest noise in person's sizes, ratio to the best pair, and outlier rate of pairs of views that agree. No reading is
tried if all pairs do."""
AGREED_BODY = {"upright": -6.0, "handed": -8.0}
"""Least log-likelihoods of the body for this. Rotated pictures reach -8, mirror images at most -9."""
_PHRASES = {
    "camera_placed": "{which} was moved after the calibration", "camera_late": "{which} is late",
    "camera_unexplained": "nothing explains {which}", "camera_names_exchanged": "camera names are swapped: {owners}",
}  # fmt: skip


@dataclass(frozen=True)
class Applied:
    """A hypothesis that explains the capture."""

    code: str  # Of its diagnostic.
    views: tuple[int, ...]  # Views with the fault.
    meaning: str  # The correction, a phrase for people. Empty if the code says it.
    gain: float  # Log-likelihood ratio against the reading without it, nats.


@dataclass(frozen=True)
class Scored:
    """A reading with its likelihood."""

    reading: Reading
    epipolar: float  # Log-likelihood ratio against unrelated views, nats.
    cost: float  # Cost of its changes, nats.
    body: BodyEvidence
    sigma: float  # Noise in person's sizes.
    outliers: float

    @property
    def share(self) -> float:
        """Return the fraction of keypoints that agree between views."""
        return 1.0 - self.outliers if self.sigma < UNRELATED_NOISE else 0.0

    @property
    def total(self) -> float:
        """Return the log-likelihood less the cost, nats."""
        return self.epipolar + self.body.total - self.cost


@dataclass(frozen=True)
class Explanation:
    """The reading of a capture, and the reasons."""

    reading: Reading  # The reading to solve. The files are taken literally if no reading wins.
    applied: tuple[Applied, ...]  # Hypotheses that explain the capture.
    agrees: bool  # The views show one body in this reading.
    margin: float  # Log-likelihood ratio against the best reading of another body, nats. Infinite if there is none.
    runner_up: str  # That reading, a phrase.
    open: tuple[str, ...] = ()  # The two best explanations where neither wins.
    share: float = 0.0  # Share of the keypoints that agree between views.
    share_written: float = 0.0  # The same, as the files are written.
    table: tuple[Scored, ...] = ()  # All readings that were judged, the best first.

    @property
    def changed(self) -> bool:
        """Return whether any hypothesis was applied."""
        return bool(self.applied)


def explain(
    cameras: Cameras, detections: Detections, *, names_stated: bool = False, rows: Sequence[Row] = ROWS
) -> Explanation:
    """Return the reading that explains C views. The literal reading is kept unless another one is certain.

    Args:
        names_stated: the user states which camera is which, so that names are not exchanged.
        rows: faults that are tried. Conventions of all files are not tried with other rows than ``ROWS``.
    """
    evidence = TakeEvidence(cameras, detections)
    written = Reading.as_written(evidence.views)
    if evidence.views < 2 or not evidence.poses:
        return Explanation(written, (), agrees=False, margin=0.0, runner_up="")
    people = detections.people()
    alone = bool(people.any()) and float(np.median(people[people > 0])) == 1.0
    search = _Search(evidence, written, rows, names_stated=names_stated, is_alone=alone)
    if search.agrees_without():
        return Explanation(written, (), agrees=True, margin=np.inf, runner_up="")
    return search.decide()


class _Search:
    """The search over readings of one capture."""

    def __init__(
        self, evidence: TakeEvidence, written: Reading, rows: Sequence[Row], *, names_stated: bool,
        is_alone: bool,
    ) -> None:  # fmt: skip
        self.evidence, self.quick, self.written = evidence, evidence.quick(), written
        self.scout = self.quick.quick(JUDGED)
        self.is_whole = rows is ROWS  # of a whole take, with the conventions of its files
        self.rows = [row for row in rows if not (names_stated and row is exchange_names)]
        self.is_alone = is_alone  # of several people the largest may be another in each view
        self.raw_constraints = self.quick.constraints(written)
        self.constraints = self.raw_constraints
        self.effect: float | None = None  # Bone lengths per independent one, in the most likely reading.
        self._densities: dict[Reading, np.ndarray] = {}
        self._proposed: dict[tuple[Row, Reading], list[Reading]] = {}

    def _rank(self, readings: Iterable[Reading], evidence: TakeEvidence | None = None) -> list[Reading]:
        """Return readings sorted by their quick score, the best first."""
        found = list(dict.fromkeys(readings))
        ratio, _ = (evidence or self.quick).likelihoods(found)
        score = [d * self.constraints - cost_of(r, self.constraints) for d, r in zip(ratio, found, strict=True)]
        return [found[k] for k in np.argsort(-np.array(score), kind="stable")]

    def _propose(self, rows: Iterable[Row], readings: Iterable[Reading]) -> list[Reading]:
        asked = [(row, reading) for reading in readings for row in rows]
        for row, reading in asked:
            if (row, reading) not in self._proposed:
                self._proposed[row, reading] = list(row(self.quick, reading))
        return [candidate for key in asked for candidate in self._proposed[key]]

    def search(self) -> list[Reading]:
        """Return readings sorted by likelihood, from common readings and then two rounds of single cameras."""
        self.quick.suspects = self.scout.suspects = self._suspects()
        everybody = len(self.quick.suspects) == self.quick.views
        common = [self.written, *(conventions(self.scout, self.written) if self.is_whole and everybody else ())]
        # Exchanged names hide another fault from the search: nothing but a mirrored ring agrees without both.
        named = [row for row in self.rows if row is exchange_names]
        common += self._propose(named, [reading for reading in common if _is_simple(reading)])
        alike = self._rank([*self._rank(common, self.scout)[:SHORTLIST], self.written])
        self.constraints = self.raw_constraints / self.quick.design_effect(alike[0])
        alike = self._rank(alike)
        found, beam = alike[:JUDGED], list(dict.fromkeys([*alike[:BEAM], self.written]))
        for _ in range(MOST_FAULTS):
            named_alike = [reading for reading in beam if reading.owners == self.written.owners][:MOVED_OF]
            starts = dict.fromkeys([*beam[:MOVED_OF], *named_alike]) if self.is_alone and self.is_whole else ()
            likely = self._rank(self._propose(self.rows, beam), self.scout)[:SHORTLIST]
            found = self._rank([*found, *likely, *self._propose(CAMERA_ROWS, starts)])
            # Exchanged names with conventions would crowd out every first fault that a moved camera is added to.
            plain = [reading for reading in found if reading.owners == self.written.owners]
            beam, before = list(dict.fromkeys([*found[:BEAM], *plain[:BEAM], self.written])), beam
            if beam == before:
                break
            self.constraints = self.raw_constraints / self.quick.design_effect(beam[0])
        if self.is_alone and self.is_whole and self.evidence.views > 2:
            found = self._rank([*found, *self._shown(found[0], alike[0])])
        self.constraints = self.raw_constraints / self.quick.design_effect(found[0])
        return self._rank(found)

    def _shown(self, best: Reading, common: Reading) -> list[Reading]:
        """Return readings with another crop of the pictures, if one explains more than the best reading."""
        everybody = len(self.quick.suspects) == self.quick.views
        starts = dict.fromkeys([best, self.written]) if everybody else ()
        free = [fit_window(self.quick, reading, FREE[-1]) for reading in starts]
        rows: list[Row] = [windows] if everybody and self._rank([best, *free])[0] != best else []
        rows += [] if best.is_uniform else [one_window]
        shown = self._propose(rows, dict.fromkeys([common, self.written]))
        return self._rank(shown, self.scout)[:BEAM]

    def score(self, readings: Sequence[Reading]) -> list[Scored]:
        """Return readings with their likelihoods."""
        ratios, noise = self.evidence.likelihoods([*readings, self.written])
        if self.effect is None:
            self.effect = judge_body(self.quick, [*readings, self.written][int(ratios.argmax())]).effect
        found = list[Scored]()
        for k, reading in enumerate(readings):
            cost, body = cost_of(reading, self.constraints), judge_body(self.quick, reading, self.effect)
            values = float(ratios[k]) * self.constraints, cost, body, float(noise.sigma[k]), float(noise.outliers[k])
            found.append(Scored(reading, *values))
        return found

    def densities(self, reading: Reading) -> np.ndarray:
        """Return (P,) log-likelihood ratios of frames, cached."""
        if reading not in self._densities:
            seen = float(np.isfinite(self.evidence.distances(self.written)).sum((0, 2)).mean())
            self._densities[reading] = self.evidence.densities(reading, seen)
        return self._densities[reading]

    def luck(self, one: Scored, other: Scored) -> float:
        """Return the part of a likelihood ratio that chance explains, from its spread in time and its rivals."""
        apart = self.densities(one.reading) - self.densities(other.reading)
        blocks = np.array([part.sum() / len(apart) for part in np.array_split(apart, min(BLOCKS, len(apart)))])
        if len(blocks) < 3:
            return 0.0
        spread = float(blocks.std(ddof=1) * np.sqrt(len(blocks))) * self.constraints
        return spread * np.sqrt(2 * max(one.cost - other.cost, np.log(8)))

    def lead(self, one: Scored, other: Scored) -> float:
        """Return the likelihood ratio in nats, without the luck."""
        return one.total - other.total - self.luck(one, other)

    def agrees_without(self, left_out: tuple[int, ...] = ()) -> bool:
        """Return whether all but some views agree as written, and the body is upright and not mirrored."""
        pairs, noise = self._written_noise
        kept = np.array([not set(pair) & set(left_out) for pair in pairs])
        if not kept.any():
            return False
        sigma, outliers = noise.sigma[kept], noise.outliers[kept]
        if sigma.max() > min(AGREED_NOISE, AGREED_TIMES * float(sigma.min())) or outliers.max() > AGREED_OUTLIERS:
            return False
        terms = judge_body(self.quick, replace(self.written, left_out=left_out)).terms
        return all(terms[name] > least for name, least in AGREED_BODY.items())

    @cached_property
    def _written_noise(self) -> tuple[list[tuple[int, int]], Noise]:
        return self.quick.pair_noise(self.written)

    def _suspects(self) -> tuple[int, ...]:
        """Return the views without which a majority of at least three others agrees, otherwise all views.

        Then the files of the others have no fault, and no convention of all files explains these views.
        """
        views = range(self.quick.views)
        for count in range(1, min(MOST_FAULTS, (len(views) - 1) // 2) + 1):
            found = [left_out for left_out in combinations(views, count) if self.agrees_without(left_out)]
            if found and len(views) - count >= LEAST_CAMERAS:
                return found[0] if len(found) == 1 else tuple(sorted({view for one in found for view in one}))
        return tuple(views)

    def _pairs_agree(self, reading: Reading) -> bool:
        """Return whether no pair of views is unrelated."""
        _, noise = self.quick.pair_noise(reading)
        return bool(noise.is_related.all())

    def _fits(self, reading: Reading) -> bool:
        """Return whether views with fitted numbers agree with the others as these do with each other.

        Another take, too, makes numbers fit, but less well.
        """
        common, _ = reading.common()
        views = [v for v, p in enumerate(reading.pictures) if reading.pose_of(v) or p.window != common.window]
        if not views:
            return not reading.is_fitted or self._pairs_agree(reading)
        own, rest = self.quick.fits_of(reading, views).density
        return bool(own > rest - AS_EXACT)

    def _is_near(self, best: Scored, other: Scored) -> bool:
        """Return whether a reading explains as much as the best.

        It is within luck, or gives one body with about the same noise. Fitted numbers absorb errors of a calibration,
        so that a reading without them needs only to agree.
        """
        alike = other.sigma <= AS_NOISY * best.sigma and other.outliers <= best.outliers + AS_NOISY - 1
        alike = alike and len(other.reading.left_out) <= len(best.reading.left_out)
        most = min(AGREED_NOISE, AGREED_TIMES * best.sigma)
        agrees = other.sigma <= most and other.outliers <= AGREED_OUTLIERS
        alike = alike or (agrees and best.reading.is_fitted and not other.reading.is_fitted)
        return self.lead(best, other) < BOUND or (alike and best.body.is_same(other.body))

    def decide(self) -> Explanation:
        """Return the winning reading, or the literal one if none wins."""
        ranked = self.search()
        likely = list(dict.fromkeys([*ranked[:JUDGED], self.written]))
        likely += [_exchange_sides(reading) for reading in likely[:4]] + [_exchange_sides(self.written)]
        if self.is_alone and self.evidence.views > 2:  # every reading must beat one odd camera
            likely += [replace(self.written, left_out=(view,)) for view in self.quick.suspects]
        likely = [reading for reading in dict.fromkeys(likely) if self._fits(reading)]
        table = sorted(self.score(likely), key=lambda s: -s.total)
        written = next(s for s in table if s.reading == self.written)
        near = [s for s in table if s is table[0] or self._is_near(table[0], s)]
        # Readings that are as near explain the capture as well, and the one with the fewest changes is likely.
        chosen = min(near, key=lambda s: (len(changes_of(s.reading)), -s.total))
        others = [s for s in table[1:] if s is not chosen and not chosen.body.is_same(s.body)]
        leads = ((self.lead(table[0], s), self.describe(s.reading)) for s in others)
        margin, runner_up = min(leads, default=(np.inf, ""))
        related = chosen.epipolar >= BOUND
        agrees = self._pairs_agree(self.written)
        explanation = Explanation(self.written, (), agrees, margin, runner_up, table=tuple(table))
        if chosen.reading == self.written:
            return explanation
        if not related or margin < BOUND:
            best = (self.describe(chosen.reading), runner_up) if related else ()
            return replace(explanation, open=best)
        changes = changes_of(chosen.reading)
        rest = self.score([without for *_, without in changes])
        applied = tuple(
            Applied(code, views, meaning, chosen.total - score.total)
            for (code, views, meaning, _), score in zip(changes, rest, strict=True)
        )
        shares = chosen.share, written.share
        agrees = self._pairs_agree(chosen.reading)
        return Explanation(chosen.reading, applied, agrees, margin, runner_up, (), *shares, tuple(table))

    def describe(self, reading: Reading) -> str:
        """Describe a reading for people."""
        names, parts = self.evidence.cameras.names, list[str]()
        for code, views, meaning, _ in changes_of(reading):
            which = ", ".join(names[v] for v in views)
            owners = ", ".join(f"{names[v]} is {names[reading.owners[v]]}" for v in views)
            usual = meaning if len(views) == len(names) else f"{meaning} ({which})"
            parts.append(_PHRASES.get(code, usual).format(which=which, owners=owners))
        return "; ".join(parts) or "everything is as written"


def _exchange_sides(reading: Reading) -> Reading:
    return replace(reading, sides=tuple(not side for side in reading.sides))


MOST_WAYS = 50_000  # Assignments that are compared: of 8 cameras to 8 there are 40,320.


def assigned_by_views(calibrated: Cameras, detections: Detections, by_order: list[int] | None) -> list[int] | None:
    """Return the calibrated camera of each recorded one by the agreement of views, None if it is not clear.

    Rings of equal cameras can be turned without a difference: then only ``by_order`` may show which is which.

    Args:
        calibrated: A cameras, in any unit.
        detections: of C recorded ones, C from 3 to A.
        by_order: (C,) the assignment that counting the names suggests, None where they do not count.
    """
    count, total = len(detections.cameras), len(calibrated)
    if not LEAST_CAMERAS <= count <= total or perm(total, count) > MOST_WAYS:
        return None
    evidence = TakeEvidence(calibrated, detections)
    if not evidence.poses:
        return None
    evidence, written = evidence.quick(SHORTLIST), Reading.as_written(count)
    ways = np.array(list(permutations(range(total), count)))
    best = ways[np.argsort(-_quick_scores(evidence, ways, total), kind="stable")[:SHORTLIST]].tolist()
    best += [by_order] if by_order is not None and by_order not in best else []
    nats = evidence.nats([replace(written, owners=tuple(owners)) for owners in best])
    likely = [best[k] for k in np.flatnonzero((nats >= BOUND) & (nats > nats.max() - BOUND))]
    return by_order if by_order in likely else likely[0] if len(likely) == 1 else None


def _quick_scores(evidence: TakeEvidence, ways: np.ndarray, total: int) -> np.ndarray:
    """Return (W,) log-likelihoods of assignments under the usual noise of detectors, pair by pair."""
    scores, usual, written = np.zeros(len(ways)), density_per_bin(0.02, 0.1), Reading.as_written(evidence.views)
    pairs = list(permutations(range(total), 2))
    for i, j in combinations(range(evidence.views), 2):
        readings = list[Reading]()
        for pair in pairs:
            owners = list(written.owners)
            owners[i], owners[j] = pair
            readings.append(replace(written, owners=tuple(owners)))
        table = np.full((total, total), -np.inf)
        table[tuple(np.array(pairs).T)] = evidence.pair_counts(readings, i, j) @ usual
        scores += table[ways[:, i], ways[:, j]]
    return scores


def _is_simple(reading: Reading) -> bool:
    """Return whether all pictures differ by one convention at most, and are not mirrored."""
    return not reading.pictures[0].mirrored and reading.correction(0).changes <= 1
