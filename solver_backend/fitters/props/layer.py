"""Props: groups of markers that nobody wears, as a layer that is solved after the person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from solver_backend.body.label_places import places_given
from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.props import Prop
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.measurements.base import NO_TERMS, SolvedLayer
from solver_backend.fitters.model.subject import FrameObjective
from solver_backend.fitters.output.build_motion import PosedTake
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.solution import SolvedFrames
from solver_backend.types import MarkerCloud, Motion


@dataclass(frozen=True)
class Props:
    """Markers of a recording that are no known places of the person."""

    loose: tuple[MarkerCloud, ...] = ()
    """Those among the person's: bones carry some of them."""
    others: tuple[MarkerCloud, ...] = ()
    """Those that are nobody's, by their prefixes."""
    SETTINGS: ClassVar[frozenset[str]] = frozenset()

    @classmethod
    def of(cls, cloud: MarkerCloud, worn: Sequence[str], layout: str, others: MarkerCloud | None) -> Props:
        """Return the markers of a recording that a person does not wear and no program computed.

        Args:
            worn: labels of the person's.
            layout: path of a file that states how labels are read, see ``read_label_places``; empty for none.
            others: markers of other prefixes.
        """
        labels = cloud.labels or ()
        names = name_markers([label for label in labels if not is_unnamed(label)], places_given(layout))
        used = {*worn, *names.virtual, *names.doubled}
        kept = [i for i, label in enumerate(labels) if label not in used]
        loose = (cloud.columns(kept, tuple(labels[i] for i in kept)),) if kept else ()
        return cls(loose, () if others is None else (others,))

    def terms(self) -> FrameObjective:
        """See ``Layer``."""
        return NO_TERMS

    def blocks(self, problem: Problem, solved: SolvedFrames, settings: SolveSettings) -> Problem:
        """See ``Layer``."""
        return problem

    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Solve the groups that keep their shape, each on its own."""
        from solver_backend.fitters.props.solve_props import solve_props

        props, found = solve_props(self, solved, progress)
        return replace(solved, diagnostics=(*solved.diagnostics, *found)), SolvedProps(props)

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """See ``SolvedLayer``."""
        return motion


@dataclass(frozen=True)
class SolvedProps:
    """Props of a take."""

    props: tuple[Prop, ...]
    """In the order in which they were solved."""

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """Return the motion with the props."""
        return replace(motion, props=self.props) if self.props else motion
