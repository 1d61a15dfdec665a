"""Measurements of one person: located points, the source they are from, and the layers that add to them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from solver_backend.body.landmark_set import Landmarks
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.diagnostics import Severity
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.model.states import FrameStates
from solver_backend.fitters.model.subject import FrameObjective, Subject
from solver_backend.residuals.terms import DataTerm
from solver_backend.types import Motion

if TYPE_CHECKING:
    from solver_backend.fitters.build_motion import PosedTake
    from solver_backend.fitters.problem import Problem, SolvedFrames
    from solver_backend.fitters.recipes.bundle import Bundle


class SolvedLayer:
    """A layer after the solve."""

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """Return the motion with the layer's results, by default as it is; ``posed`` is the body in all frames."""
        return motion


class Layer(SolvedLayer):
    """One kind of measurement: its part in the solve of a body, and its results in the motion."""

    SETTINGS: ClassVar[frozenset[str]] = frozenset()  # Settings that it reads in addition to the method's.

    def terms(self) -> FrameObjective:
        """Return the terms that it adds to the objective of every frame, by default none."""
        return FrameObjective(())

    def blocks(self, problem: Problem, solved: SolvedFrames, settings: SolveSettings) -> Problem:
        """Return the problem with the landmarks that the layer adds after a first solve, by default the same one.

        A problem with other landmarks is solved again.
        """
        return problem

    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Return the poses as they are with the layer, and what was solved with them."""
        return solved, self


class PointSource(Layer):
    """The layer of the body's own points."""

    KEEPS_BONES: ClassVar[bool] = False
    """``record`` needs the rotations of the bones, which take more memory than all else."""
    REST: ClassVar[RestWords]  # How parts are reported that nothing informs.

    @property
    def recipe(self) -> str:
        """Row of ``methods.RECIPES`` that solves a whole take."""
        return "views"

    @property
    def calibrated(self) -> bool:
        """Whether the landmarks' places on the body are known to millimetres."""
        return False

    def report(self, points: np.ndarray) -> tuple[np.ndarray | None, dict[str, float]]:
        """Return (C, F, L) reprojection errors in pixels, if there are images, and statistics, of (F, L, 3) points."""
        raise NotImplementedError

    def constant_m(self, layout: BodyLayout) -> np.ndarray:
        """Return (J,) standard deviations per axis of errors that do not average out at each joint, metres."""
        raise NotImplementedError

    def learn_noise(self, bundle: Bundle) -> DataTerm:
        """Return the data term with the noise that the poses of a bundle leave."""
        raise NotImplementedError


@dataclass(frozen=True)
class RestWords:
    """How parts of the body that nothing informs are reported."""

    severity: Severity  # Of the diagnostic.
    one: str  # What one part lacks.
    several: str  # What several parts lack.


@dataclass(frozen=True)
class RoughMotion:
    """Poses of some frames of a take."""

    frames: np.ndarray  # (S,) frame numbers, ascending.
    states: FrameStates  # S poses as codes.


@dataclass(frozen=True)
class Measurements:
    """F frames of L points of one person."""

    landmarks: Landmarks  # The L points on the body.
    points: np.ndarray  # (F, L, 3) world metres, NaN where a point was not located.
    covariance: np.ndarray  # (F, L, 3, 3) m²; NaN or anything where there is no point.
    term: DataTerm  # How far landmarks are from what was measured.
    fps: float  # Frames per second.
    source: PointSource  # What the points are from.
    known_person: Subject | None = None
    """The person, where they are known before the solve: markers are calibrated first."""
    rough: RoughMotion | None = None  # Where to start from, where that was found with the person.
    layers: tuple[Layer, ...] = ()  # What adds to the points, in the order in which it is finished after the body.
    provenance: dict[str, Any] = field(default_factory=dict)
    """What a motion records of them: noise, and faults that were found."""

    @property
    def terms(self) -> FrameObjective:
        """What source and layers add to the data term."""
        parts = [layer.terms() for layer in (self.source, *self.layers)]
        points, poses, relative = (
            tuple(term for part in parts for term in getattr(part, name)) for name in ("points", "poses", "relative")
        )
        return FrameObjective(points, poses, relative)

    @property
    def knows_person(self) -> bool:
        """Whether shape and landmarks are known before the solve."""
        return self.known_person is not None

    @property
    def num_frames(self) -> int:
        """F."""
        return len(self.points)

    @property
    def located(self) -> np.ndarray:
        """(F, L) bool: the points that are known."""
        return np.isfinite(self.points).all(-1)

    @property
    def seen(self) -> np.ndarray:
        """(F,) bool: enough points are known to place a body."""
        return seen_frames(self.points)


def seen_frames(points: np.ndarray) -> np.ndarray:
    """Return (F,) bool: enough of the (F, L, 3) points, NaN where missing, are known to place a body."""
    located = np.isfinite(points).all(-1)
    return located.sum(-1) >= min(6, located.shape[1] // 2)
