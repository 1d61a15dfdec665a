"""Search the interpretation that explains a capture, and decide whether it is certain."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from math import perm

import numpy as np

from solver_backend.agreement.body_evidence import BodyEvidence, judge_body
from solver_backend.agreement.evidence import (
    BOUND,
    CENTRES,
    EACH,
    LEAST_CAMERAS,
    MOVED,
    PEOPLE,
    UNRELATED_NOISE,
    UNRELATED_OUTLIERS,
    TakeEvidence,
    fit_noise,
    log_density,
)
from solver_backend.agreement.hypotheses import (
    CAMERA_ROWS,
    FREE,
    RANGE_ROWS,
    ROWS,
    Row,
    changes_of,
    conventions,
    cost_of,
    exchange_names,
    fit_window,
    one_window,
    windows,
)
from solver_backend.agreement.reading import Reading
from solver_backend.types import Cameras, Detections

BEAM, MOST_FAULTS = 6, 2
"""Interpretations to start from in each round, and largest number of faulty cameras. Twice as many interpretations are
triangulated, and four times as many are ranked with all poses."""
AGREED_TIMES = UNRELATED_NOISE / MOVED  # Largest ratio of a pair's noise to the best pair's, if no camera has a fault.
AS_NOISY = 1.2  # Largest ratio of noise at which the simpler of two interpretations with one body wins.
AS_EXACT = np.log(AS_NOISY)
"""Largest deficit in the mean log density of a fitted view, in nats. It separates 48 simulated moved cameras of eight
tuning takes (at most 0.18) from 21 of 24 cameras of another take (at least 0.23)."""
_PHRASES = {
    "camera_placed": "{which} was moved after the calibration", "camera_late": "{which} is late",
    "camera_unexplained": "{which} has an unknown fault",
    "camera_names_exchanged": "camera names are swapped: {owners}",
}  # fmt: skip


@dataclass(frozen=True)
class Applied:
    """Hypothesis about a fault of the files, which the chosen interpretation corrects."""

    code: str  # Code of its diagnostic.
    views: tuple[int, ...]  # Views with the fault.
    meaning: str  # Correction, as text for users. Empty if the code is sufficient.
    gain: float  # Log-likelihood ratio relative to the interpretation without it, nats.


@dataclass(frozen=True)
class Scored:
    """Interpretation with its likelihood, its cost and the plausibility of the body."""

    reading: Reading
    epipolar: float  # Log-likelihood ratio relative to unrelated views, nats.
    cost: float  # Cost of its changes, nats.
    body: BodyEvidence

    @property
    def total(self) -> float:
        """Return the log-likelihood minus the cost in nats."""
        return self.epipolar + self.body.total - self.cost


@dataclass(frozen=True)
class Explanation:
    """Chosen interpretation of a capture's files, and the evidence for it."""

    reading: Reading  # Interpretation to solve. It is the literal one if none wins.
    applied: tuple[Applied, ...]  # Hypotheses that explain the capture.
    agrees: bool  # Whether the views show one body in this interpretation.
    margin: float
    """Log-likelihood ratio in nats relative to the best one with another body or without one change, or infinity."""
    runner_up: str  # That interpretation, as text.
    open: tuple[str, ...] = ()  # The two best explanations if neither wins.
    share: float = 0.0  # Share of the keypoints that agree between views.
    share_written: float = 0.0  # The same for the literal interpretation.

    @property
    def changed(self) -> bool:
        """Return whether any hypothesis was applied."""
        return bool(self.applied)


def explain(cameras: Cameras, detections: Detections, rows: Sequence[Row] = ROWS) -> Explanation:
    """Find the best interpretation of the files of C views. Keep the literal one unless another is certain.

    ``rows`` are the hypotheses to try. Conventions that all files share are tried, too, except with ``RANGE_ROWS``.
    """
    evidence = TakeEvidence(cameras, detections)
    written = Reading.as_written(evidence.views)
    if evidence.views < 2 or not evidence.poses:
        return Explanation(written, (), agrees=False, margin=0.0, runner_up="")
    search = _Search(evidence, rows)
    if search.is_settled(written):
        return Explanation(written, (), agrees=True, margin=np.inf, runner_up="")
    if detections.xy.shape[2] > 1:  # Which people all views show is known only under the correct interpretation.
        everybody = _Search(TakeEvidence(cameras, detections, people=PEOPLE).quick(2 * BEAM), rows)
        ranked = [written] if everybody.is_settled(written) else everybody.search()
        if everybody.evidence.noise(ranked[:1]).sigma[0] <= MOVED:
            search = _Search(evidence.under(ranked[0]), rows)
            if ranked[0].left_out or not search.is_settled(ranked[0], np.inf):  # A bad calibration is no fault.
                ranked = search.search(ranked)
                search = _Search(evidence.under(ranked[0]), rows)
            return search.decide(ranked)
    return search.decide(search.search())


class _Search:
    def __init__(self, evidence: TakeEvidence, rows: Sequence[Row]) -> None:
        self.evidence, self.quick, self.written = evidence, evidence.quick(), Reading.as_written(evidence.views)
        self.scout = self.quick.quick(2 * BEAM)
        self.rows, self.is_whole = rows, rows is not RANGE_ROWS  # A whole take has conventions of its files.
        self.constraints = self.quick.comparisons()
        self.effect: float | None = None  # Bone lengths per independent one, for the most likely interpretation.
        self._proposed: dict[tuple[Row, Reading], list[Reading]] = {}

    def _rank(self, readings: Iterable[Reading], evidence: TakeEvidence | None = None) -> list[Reading]:
        found = list(dict.fromkeys(readings))
        ratio = (evidence or self.quick).likelihoods(found)
        if evidence is None:  # Of the most likely one, because the errors of a wrong one depend on each other.
            self.constraints = self.quick.constraints(found[int(ratio.argmax())])
        score = [d * self.constraints - cost_of(r, self.constraints) for d, r in zip(ratio, found, strict=True)]
        return [found[k] for k in np.argsort(-np.array(score), kind="stable")]

    def _propose(self, rows: Iterable[Row], readings: Iterable[Reading]) -> list[Reading]:
        asked = [(row, reading) for reading in readings for row in rows]
        for row, reading in asked:
            if (row, reading) not in self._proposed:
                self._proposed[row, reading] = list(row(self.quick, reading))
        return [candidate for key in asked for candidate in self._proposed[key]]

    def _common(self) -> tuple[list[Reading], list[Reading]]:
        """Return the most likely corrections of all cameras, and interpretations to start from for single cameras."""
        everybody = len(self.quick.suspects) == self.quick.views
        common = [self.written, *(conventions(self.scout, self.written) if self.is_whole and everybody else ())]
        # Swapped names hide other faults: only in a mirrored ring do views agree after fixing one.
        simple = (r for r in common if r.pictures[0].mirrored + r.correction(0).changes <= 1)
        common += self._propose([row for row in self.rows if row is exchange_names], list(simple))
        alike = self._rank([*self._rank(common, self.scout)[: 4 * BEAM], self.written])
        # A camera with a fault of its own hides the convention on which the other cameras agree.
        counts, cost = self.scout.counts(common), np.array([cost_of(r, self.constraints) for r in common])
        fits = (fit_noise(counts[[v not in pair for pair in self.scout.pairs]].sum(0)) for v in self.quick.suspects)
        partly = [common[n] for f in fits if f.is_related[n := int((f.density * self.constraints - cost).argmax())]]
        return alike[: 2 * BEAM], [*alike[:BEAM], *partly, self.written]

    def search(self, known: Sequence[Reading] = ()) -> list[Reading]:
        """Return likely interpretations, the best first. Only faults that need one person are added to ``known``."""
        self.quick.suspects = self.scout.suspects = self._suspects()
        alike, beam = (known[: 2 * BEAM], known[:BEAM]) if known else self._common()
        found, beam, rows = list(alike), list(dict.fromkeys(beam)), () if known else self.rows
        for _ in range(MOST_FAULTS):
            named_alike = [reading for reading in beam if reading.owners == self.written.owners][:MOST_FAULTS]
            starts = dict.fromkeys([*beam[:MOST_FAULTS], *named_alike]) if self.is_whole else ()
            likely = self._rank(self._propose(rows, beam), self.scout)[: 4 * BEAM]
            found = self._rank([*found, *likely, *self._propose(CAMERA_ROWS, starts)])
            # Keep some without swapped names, which would displace every fault to combine with a moved camera.
            plain = [reading for reading in found if reading.owners == self.written.owners]
            beam, before = list(dict.fromkeys([*found[:BEAM], *plain[:BEAM], self.written])), beam
            if beam == before:
                break
        shown = self._shown(found[0], alike[0]) if self.is_whole and self.evidence.views > 2 else ()
        return self._rank([*found, *shown])

    def _shown(self, best: Reading, common: Reading) -> list[Reading]:
        """Return interpretations with another image crop, if such a crop fits better than ``best``."""
        starts = dict.fromkeys([best, self.written]) if len(self.quick.suspects) == self.quick.views else ()
        free = [fit_window(self.quick, reading, FREE[-1]) for reading in starts]
        own, *fitted = self.quick.noise([best, *free]).density.tolist()
        rows: list[Row] = [windows] if max(fitted, default=own) > own + AS_EXACT else []
        is_uniform = len({*zip(best.pictures, best.sides, strict=True)}) == 1 and not best.is_of_one_camera
        rows += [] if is_uniform else [one_window]
        shown = self._propose(rows, dict.fromkeys([common, self.written]))
        return self._rank(shown, self.scout)[:BEAM]

    def score(self, readings: Sequence[Reading]) -> list[Scored]:
        """Compute the likelihood, the cost and the body evidence of each interpretation."""
        ratios = self.evidence.likelihoods([*readings, self.written])
        if self.effect is None:
            self.effect = judge_body(self.quick, [*readings, self.written][int(ratios.argmax())]).effect
        return [
            Scored(r, float(d) * self.constraints, cost_of(r, self.constraints), judge_body(self.quick, r, self.effect))
            for r, d in zip(readings, ratios, strict=False)  # without the last one
        ]

    def is_settled(self, reading: Reading, times: float = AGREED_TIMES) -> bool:
        """Return whether all views agree with an upright body, with at most ``times`` the noise of the best pair."""
        pairs, noise = self.quick.pair_noise(reading)
        kept = np.array([not {*pair} & {*reading.left_out} for pair in pairs])
        if not kept.any():
            return False
        sigma, outliers = noise.sigma[kept], noise.outliers[kept]
        is_quiet = sigma.max() <= min(MOVED, times * float(sigma.min())) and outliers.max() <= UNRELATED_OUTLIERS
        if not is_quiet or self.evidence.people > 1:
            return bool(is_quiet)
        terms = judge_body(self.quick, reading).terms
        return terms["upright"] > -BOUND and terms["handed"] > -BOUND

    def _suspects(self) -> tuple[int, ...]:
        """Return the views that may have a fault.

        If a majority of at least three views agrees without corrections, only the other views are suspects. No
        convention common to all files is wrong then. Otherwise all views are suspects.
        """
        views = self.quick.views
        for count in range(1, min(MOST_FAULTS, (views - 1) // 2, views - LEAST_CAMERAS) + 1):
            tried = (replace(self.written, left_out=out) for out in combinations(range(views), count))
            if found := {view for reading in tried if self.is_settled(reading) for view in reading.left_out}:
                return tuple(sorted(found))
        return tuple(range(views))

    def _agree(self, reading: Reading) -> bool:
        """Return whether all views show one body under an interpretation, which determines the person they share."""
        return bool(self.evidence.under(reading).quick().pair_noise(reading)[1].is_related.all())

    def _fits(self, reading: Reading) -> bool:
        """Return whether views with a fitted pose or image crop agree as well as the other views do."""
        common, _ = reading.common()
        views = [v for v, p in enumerate(reading.pictures) if reading.moved[v] or p.window != common.window]
        if not views:
            return not reading.is_fitted or bool(self.quick.pair_noise(reading)[1].is_related.all())
        own, rest = self.quick.fits_of(reading, views).density
        return bool(own > rest - AS_EXACT)

    def _is_near(self, best: Scored, other: Scored) -> bool:
        """Return whether an interpretation explains the capture nearly as well as the best one.

        The likelihoods may be similar, or both interpretations may give the same body with similar noise. If only the
        best one has fitted parameters, which absorb calibration errors, the other one only needs views that agree.
        """
        absorbed = best.reading.is_fitted and not other.reading.is_fitted
        alike = self._is_as_quiet(other, best, absorbed=absorbed) and best.body.is_same(other.body)
        return best.total - other.total < BOUND or alike or self._absorbs(best, other)

    def _is_as_quiet(self, one: Scored, best: Scored, *, absorbed: bool = False) -> bool:
        """Return whether ``one`` has about the noise of ``best``, or with ``absorbed``, whether its views agree.

        Only pairs with a view that the two interpret differently are compared, because all others dilute its fault.
        """
        views = one.reading.differs_in(best.reading)
        noise, least = (self.evidence.fits_of(scored.reading, views) for scored in (one, best))
        k = int(views <= {*best.reading.left_out})  # Then all pairs of the best one are without these views.
        (sigma, outliers), (low, few) = (noise.sigma[0], noise.outliers[0]), (least.sigma[k], least.outliers[k])
        if absorbed and sigma <= min(MOVED, AGREED_TIMES * low) and outliers <= UNRELATED_OUTLIERS:
            return True
        alike = sigma <= AS_NOISY * low and 2 * (outliers - few) <= UNRELATED_OUTLIERS
        return bool(alike) and len(one.reading.left_out) <= len(best.reading.left_out)

    def _absorbs(self, cropped: Scored, plain: Scored) -> bool:
        """Return whether a fitted crop of the images only absorbs calibration errors, so that it is no evidence."""
        return cropped.reading.is_cropped and not plain.reading.is_cropped and self._is_as_quiet(plain, cropped)

    def decide(self, ranked: Sequence[Reading]) -> Explanation:
        """Return the winner of a search, or the literal interpretation if no other one is certain."""
        likely = list(dict.fromkeys([*self._rank(ranked)[: 2 * BEAM], self.written]))
        likely += [replace(r, sides=tuple(not side for side in r.sides)) for r in (*likely[:4], self.written)]
        for reading in likely:  # including the ones added here, because each has to beat all simpler ones
            likely += [without for *_, without in changes_of(reading) if without not in likely]
        if self.evidence.views > 2:  # All must beat the hypothesis of one bad camera.
            likely += [replace(self.written, left_out=(view,)) for view in self.quick.suspects]
        table = sorted(self.score([r for r in dict.fromkeys(likely) if self._fits(r)]), key=lambda s: -s.total)
        # If all views but one agree without a correction, a correction may not make them agree less than they do.
        rest = [self.evidence.fits_of(self.written, [view]) for view in self.quick.suspects]
        least = max((fit.density[1] for fit in rest if fit.is_related[1]), default=-np.inf) - np.log(AGREED_TIMES)
        exempt = {self.written, *(reading for reading in likely if reading.left_out)}
        table = [s for s in table if s.reading in exempt or self.evidence.noise([s.reading]).density[0] > least]
        near = [s for s in table if s is table[0] or self._is_near(table[0], s)]
        # All of these explain the capture equally well, so the one with the fewest changes is the most likely.
        chosen = min(near, key=lambda s: (len(changes_of(s.reading)), s.reading.is_cropped, -s.total))
        others = [s for s in table[1:] if not (s is chosen or chosen.body.is_same(s.body) or self._absorbs(s, chosen))]
        changes = changes_of(chosen.reading)
        needed = self.score([without for *_, without in changes])  # Each change must be needed, too.
        leads = [(table[0].total, s) for s in others] + [(chosen.total, s) for s in needed]
        margin, runner_up = min(((lead - s.total, self.describe(s.reading)) for lead, s in leads), default=(np.inf, ""))
        noise = self.evidence.noise([chosen.reading, self.written])
        related = chosen.epipolar >= BOUND and noise.sigma[0] <= MOVED and chosen.body.terms["handed"] > -BOUND
        if chosen.reading == self.written or not related or margin < BOUND:
            best = (self.describe(chosen.reading), runner_up) if related and chosen.reading != self.written else ()
            return Explanation(self.written, (), self._agree(self.written), margin, runner_up, best)
        applied = tuple(Applied(*c[:3], chosen.total - s.total) for c, s in zip(changes, needed, strict=True))
        agrees = self._agree(chosen.reading)
        return Explanation(chosen.reading, applied, agrees, margin, runner_up, (), *noise.share.tolist())

    def describe(self, reading: Reading) -> str:
        """Describe an interpretation in text for users."""
        names, parts = self.evidence.cameras.names, list[str]()
        for code, views, meaning, _ in changes_of(reading):
            which = ", ".join(names[v] for v in views)
            owners = ", ".join(f"{names[v]} is {names[reading.owners[v]]}" for v in views)
            usual = meaning if len(views) == len(names) else f"{meaning} ({which})"
            parts.append(_PHRASES.get(code, usual).format(which=which, owners=owners))
        return "; ".join(parts) or "the files are correct"


def assigned_by_views(calibrated: Cameras, detections: Detections, by_order: list[int] | None) -> list[int] | None:
    """Find the calibrated camera of each recorded camera, by comparing the views.

    Return None if no assignment fits, or if several do. A ring of equal cameras looks the same after a rotation, so
    that several assignments fit. The assignment ``by_order`` of numbered names (``counted_order``) then wins if it
    fits.
    """
    count, total = len(detections.cameras), len(calibrated)
    if not LEAST_CAMERAS <= count <= total or perm(total, count) > perm(EACH, EACH):
        return None
    evidence = TakeEvidence(calibrated, detections)
    if not evidence.poses:
        return None
    evidence, written = evidence.quick(4 * BEAM), Reading.as_written(count)
    usual, ways = log_density(CENTRES, MOVED, UNRELATED_OUTLIERS), np.array(list(permutations(range(total), count)))
    pairs, scores = list(permutations(range(total), 2)), np.zeros(len(ways))
    for i, j in combinations(range(count), 2):
        readings = [written.with_view(i, owners=a).with_view(j, owners=b) for a, b in pairs]
        table = np.full((total, total), -np.inf)
        table[tuple(np.array(pairs).T)] = evidence.pair_counts(readings, i, j) @ usual
        scores += table[ways[:, i], ways[:, j]]
    best = ways[np.argsort(-scores, kind="stable")[: 4 * BEAM]].tolist()
    best += [by_order] if by_order is not None and by_order not in best else []
    readings = [replace(written, owners=tuple(owners)) for owners in best]
    ratios = evidence.likelihoods(readings)
    nats = ratios * evidence.constraints(readings[int(ratios.argmax())])
    likely = [best[k] for k in np.flatnonzero((nats >= BOUND) & (nats > nats.max() - BOUND))]
    return by_order if by_order in likely else likely[0] if len(likely) == 1 else None
