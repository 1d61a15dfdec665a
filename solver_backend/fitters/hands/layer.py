"""The layer that solves hands on the wrists of a solved body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.hands.shown_hands import HandClouds, HandViews
from solver_backend.fitters.layers import Layer, SolvedLayer
from solver_backend.fitters.problem import Problem, SolvedFrames
from solver_backend.types import Cameras, Keypoints2D


@dataclass(frozen=True)
class Hands(Layer):
    """Both hands of one person. Wrists follow hands after the body, whose keypoints locate them better."""

    shown: HandViews | HandClouds  # What shows them.
    SETTINGS: ClassVar[frozenset[str]] = frozenset({"learn_noise"})

    @classmethod
    def of_views(cls, cameras: Cameras, keypoints: Keypoints2D) -> tuple[Hands, ...]:
        """Return the hands of a person, none where no view shows any."""
        views = HandViews.of(cameras, keypoints)
        return () if views is None else (cls(views),)

    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Solve the hands on their wrists, and let the arms follow."""
        from solver_backend.fitters.hands.solve_hands import solve_hands

        solved, hands = solve_hands(self.shown, solved, problem.fps, settings, progress)
        return solved, hands or self
