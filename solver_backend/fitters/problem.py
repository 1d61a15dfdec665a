"""Define the measurements of one person, and the problem and solution built from them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import reduce
from operator import add
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.exchange.diagnostics import Diagnostic, Severity
from solver_backend.exchange.progress import Progress
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.model.subject import FrameObjective, FrameStates, PosedFrames, Subject
from solver_backend.geometry.arrays import Array
from solver_backend.priors.base import AutoencodingPrior
from solver_backend.priors.prior_on_body import prior_on_body
from solver_backend.residuals.pose_mixture import PoseMixtureTerm
from solver_backend.residuals.terms import DataTerm, PointTerm, PoseTerm
from solver_backend.solver.levenberg_marquardt import LMResult
from solver_backend.types import Motion

if TYPE_CHECKING:
    from solver_backend.fitters.build_motion import PosedTake
    from solver_backend.fitters.other_skin import OtherSkin
    from solver_backend.fitters.recipes.bundle import Bundle


class SolvedLayer:
    """Completed solve for one kind of measurement. It adds its results to the motion."""

    def record(self, motion: Motion, posed: PosedTake) -> Motion:
        """Add the layer's results to the motion. ``posed`` is the body in all frames."""
        return motion


class Layer(SolvedLayer):
    """Part of a solve for one kind of measurement, such as points, hands or props."""

    SETTINGS: ClassVar[frozenset[str]] = frozenset()  # Settings that the layer reads in addition to the method's.

    def terms(self) -> FrameObjective:
        """Return the terms that the layer adds to the objective of every frame, by default none."""
        return FrameObjective(())

    def blocks(self, problem: Problem, solved: SolvedFrames, settings: SolveSettings) -> Problem:
        """Change the problem after a first solve, for example by adding landmarks.

        A changed problem is solved again.
        """
        return problem

    def after(
        self, problem: Problem, solved: SolvedFrames, settings: SolveSettings, progress: Progress
    ) -> tuple[SolvedFrames, SolvedLayer]:
        """Run the layer's own solve after the body. Return the adjusted poses and the solved layer."""
        return solved, self


@dataclass(frozen=True)
class PointSource(Layer):
    """Layer with the points that determine the body, such as keypoints or markers."""

    KEEPS_BONES: ClassVar[bool] = False  # Whether ``record`` needs the bones' rotations, which take the most memory.
    REST: ClassVar[RestWords]  # Text that reports undetermined body parts.

    @property
    def recipe(self) -> str:
        """Name of the plan in ``bundle.PLANS`` by which a whole take is solved."""
        return "views"

    @property
    def calibrated(self) -> bool:
        """True if the landmarks' positions on the body are known to within millimetres."""
        return False

    @property
    def knows_floor(self) -> bool:
        """True if the floor is at z = 0 even if the user does not say so."""
        return True

    def report(self, points: np.ndarray) -> tuple[np.ndarray | None, dict[str, float]]:
        """Return reprojection errors (C, F, L) in pixels, and statistics of the points (F, L, 3)."""
        raise NotImplementedError

    def constant_m(self, layout: BodyLayout) -> np.ndarray:
        """Return the deviations (J,) in metres of joint errors that do not average out over a take."""
        raise NotImplementedError

    def learn_noise(self, bundle: Bundle) -> DataTerm:
        """Learn the measurement noise from the poses in a bundle, and return a data term that uses it."""
        raise NotImplementedError


@dataclass(frozen=True)
class RestWords:
    """Wording of diagnostics about body parts without measurements."""

    severity: Severity  # Severity of the diagnostic.
    one: str  # Text for one part.
    several: str  # Text for several parts.


@dataclass(frozen=True)
class RoughMotion:
    """Poses in some frames, which serve as initial values."""

    frames: np.ndarray  # (S,) frame numbers, ascending.
    states: FrameStates  # S poses as codes.


@dataclass(frozen=True)
class Measurements:
    """Measurements of L points on one person over F frames, prepared for a solve."""

    landmarks: Landmarks  # The L points on the body.
    points: np.ndarray  # (F, L, 3) world metres, NaN where a point is unknown.
    covariance: np.ndarray  # (F, L, 3, 3) m², undefined where there is no point.
    term: DataTerm  # Distances between landmarks and measurements.
    fps: float  # Frames per second.
    source: PointSource  # Source of the points.
    known_person: Subject | None = None  # Person known before the solve. Markers are calibrated first.
    rough: RoughMotion | None = None  # Initial poses, if they were found together with the person.
    layers: tuple[Layer, ...] = ()  # Further measurements, which are finished after the body in this order.
    provenance: dict[str, Any] = field(default_factory=dict)  # Noise and faults, for the motion's record.

    @property
    def knows_person(self) -> bool:
        """True if body shape and landmarks are known before the solve."""
        return self.known_person is not None

    @property
    def num_frames(self) -> int:
        """Number of frames in the take."""
        return len(self.points)

    @property
    def located(self) -> np.ndarray:
        """(F, L) mask of known points."""
        return np.isfinite(self.points).all(-1)

    @property
    def seen(self) -> np.ndarray:
        """(F,) mask of frames with enough known points to place a body."""
        return seen_frames(self.points)


def noted(record: Mapping[str, Any], found: Iterable[Diagnostic]) -> dict[str, Any]:
    """Append diagnostics to a motion's provenance."""
    return {**record, "diagnostics": [*record.get("diagnostics", ()), *(item.as_dict() for item in found)]}


def seen_frames(points: np.ndarray) -> np.ndarray:
    """Return an (F,) mask of frames with enough known points to place a body."""
    located = np.isfinite(points).all(-1)
    return located.sum(-1) >= min(6, located.shape[1] // 2)


REFERENCE_FPS = 60.0  # Settings count windows in frames at this rate, as human motion does not depend on the camera.
SAMPLE_FRAMES = 200  # Largest number of frames used to learn shape, bias and noise between passes.


@dataclass(frozen=True)
class Problem:
    """Measurements and priors of one person, prepared for a solver method."""

    body: Body
    prior: AutoencodingPrior
    measurements: Measurements
    pose_terms: tuple[PoseTerm, ...]
    others: OtherSkin | None = None  # Skin of people who have already been solved.
    stature_m: float = 0.0  # Stature that a free body shape keeps in metres, 0 if unknown.

    @classmethod
    def of(cls, body: Body, prior: AutoencodingPrior, measurements: Measurements) -> Problem:
        """Build the problem. The prior is restricted to the body's joints, and the mixture prior for poses is added.

        Raises:
            PriorInvalid: the prior is inconsistent or does not fit the body.
        """
        fitting = prior_on_body(prior, body.layout)
        return cls(body, fitting, measurements, (PoseMixtureTerm.of(fitting.joints),))

    @property
    def objective(self) -> FrameObjective:
        """Terms on single frames, from data, pose prior, point source and layers."""
        return self.objective_of((self.measurements.term,))

    def objective_of(self, points: tuple[PointTerm, ...]) -> FrameObjective:
        """Return the objective with other point terms in place of the data term."""
        layers = (self.measurements.source, *self.measurements.layers)
        return reduce(add, (layer.terms() for layer in layers), FrameObjective(points, self.pose_terms))

    @property
    def fps(self) -> float:
        """Frame rate of the take in Hz."""
        return self.measurements.fps

    @property
    def num_frames(self) -> int:
        """Number of frames in the take."""
        return self.measurements.num_frames

    @property
    def sample(self) -> np.ndarray:
        """Up to ``SAMPLE_FRAMES`` frame numbers, spread over the take."""
        count = self.num_frames
        return np.unique(np.linspace(0, count - 1, min(count, SAMPLE_FRAMES)).astype(int))

    def frames_of(self, window: int, least: int = 2) -> int:
        """Convert a window length in frames at 60 fps to this take's frame rate."""
        return max(least, round(window * self.fps / REFERENCE_FPS))


@dataclass(frozen=True)
class Solution:
    """A solved take: the motion, and a sentence about how the solve ended."""

    motion: Motion
    status: str
    """One sentence about the end of the last pass, also stored in the motion's provenance."""


@dataclass(frozen=True)
class Convergence:
    """Convergence of a solve at its last robust scale. A solve may have several parts, such as windows."""

    parts: int
    converged: int  # Number of parts whose cost is stable.
    iterations: int  # Largest number of linearisations of any part.

    @classmethod
    def of(cls, result: LMResult[Any]) -> Convergence:
        """Return the convergence of one minimisation."""
        return cls(1, int(result.converged), result.iterations)

    @classmethod
    def joined(cls, parts: Iterable[Convergence]) -> Convergence:
        """Combine the convergence of several parts."""
        found = list(parts)
        converged = sum(part.converged for part in found)
        return cls(sum(part.parts for part in found), converged, max(part.iterations for part in found))

    @property
    def status(self) -> str:
        """Sentence for users that says how the solve ended."""
        if self.converged == self.parts:
            return f"Converged: the cost no longer changes after {self.iterations} linearisations."
        where = "" if self.parts == 1 else f" in {self.parts - self.converged} of {self.parts} parts of the take"
        return f"Stopped after {self.iterations} linearisations{where}. More iterations may help."


@dataclass(frozen=True)
class SolvedFrames:
    """Solved poses of a take, with all other estimates of the solver method."""

    subject: Subject  # Contains the shape and bias from the last pass.
    frames: PosedFrames
    key_times: np.ndarray = field(default_factory=lambda: np.arange(0))  # Frame numbers of the keys, or fractions.
    covariance: Array | None = None  # (F, J, 6) of each joint, m² (see ``packed``), if the method estimates it.
    turns: Array | None = None  # (F, S, 6) of each segment's rotation, rad² (see ``turn_covariance``), if estimated.
    contacts: np.ndarray | None = None  # (F, 2) bool: left and right foot are planted, if the method detects it.
    touches: np.ndarray | None = None  # (F, 11) bool: parts on the floor (``CONTACT_PARTS``), None if only feet are.
    fitted: PosedFrames | None = None  # Poses that fit the measurements, before parts were put at rest. None if equal.
    resting: np.ndarray | None = None  # (F, J) bool: joints at rest without measurements, None if there are none.
    diagnostics: tuple[Diagnostic, ...] = ()  # For the motion.

    def noting(self, found: Iterable[Diagnostic]) -> SolvedFrames:
        """Append diagnostics for the motion."""
        return replace(self, diagnostics=(*self.diagnostics, *found))


MethodResult = tuple[SolvedFrames, Convergence]  # What a method returns.
