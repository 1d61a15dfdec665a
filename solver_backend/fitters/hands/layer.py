"""Hands that views or markers show beside the body: the layer that solves them on its wrists."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.build_motion import PosedTake
from solver_backend.fitters.hands.shown_hands import HandClouds, HandViews
from solver_backend.fitters.layers import NO_TERMS, SolvedLayer
from solver_backend.fitters.model.subject import FrameObjective
from solver_backend.fitters.problem import Problem, SolvedFrames
from solver_backend.types import Cameras, Keypoints2D, Motion


@dataclass(frozen=True)
class Hands:
    """Both hands of one person."""

    shown: HandViews | HandClouds
    """What shows them."""
    SETTINGS: ClassVar[frozenset[str]] = frozenset({"learn_noise"})

    @classmethod
    def of_views(cls, cameras: Cameras, keypoints: Keypoints2D) -> tuple[Hands, ...]:
        """Return the hands of a person; none where no view shows any."""
        views = HandViews.of(cameras, keypoints)
        return () if views is None else (cls(views),)

    def terms(self) -> FrameObjective:
        """See ``Layer``: wrists follow hands after the body, whose keypoints locate them better."""
        return NO_TERMS

    def blocks(self, problem: Problem, solved: SolvedFrames, settings: SolveSettings) -> Problem:
        """See ``Layer``."""
        return problem

    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Solve the hands on their wrists, and let the arms follow."""
        from solver_backend.fitters.hands.solve_hands import solve_hands

        solved, hands = solve_hands(self.shown, solved, problem.fps, settings, progress)
        return solved, hands or self

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """Return the motion as it is: without solved hands it has no fingers."""
        return motion
