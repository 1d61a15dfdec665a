"""The unknowns of a calibration: shape, places of the markers, and the poses of the frames that are looked at."""

from __future__ import annotations

from dataclasses import dataclass, replace

from array_api_compat import array_namespace

from solver_backend.body.state_layout import StateLayout
from solver_backend.fitters.model.codes import decoded, state_layout
from solver_backend.fitters.model.frame_states import FrameStates
from solver_backend.fitters.model.keyframes import rotations_of
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.subject_calibration.shape import moved
from solver_backend.geometry.arrays import Array, zeros
from solver_backend.priors.base import PosePrior


@dataclass(frozen=True)
class CalibrationState:
    """A person and F poses, which may leave the prior's manifold as they may in the bundle."""

    subject: Subject
    """The person."""
    frames: FrameStates
    """Codes, roots and translations."""
    residual: Array
    """(F, J, 3) rotation vectors by which joints leave the manifold."""
    layout: StateLayout
    """Of the unknowns of a frame."""

    @classmethod
    def of(cls, subject: Subject, prior: PosePrior, frames: FrameStates) -> CalibrationState:
        """Return the state of poses on the manifold."""
        still = zeros((frames.z.shape[0], len(prior.joints), 3), frames.z)
        residual = still if frames.residual is None else frames.residual
        return cls(subject, replace(frames, residual=None), residual, state_layout(prior))

    def poses(self, prior: PosePrior) -> PosedFrames:
        """Return the poses that the states decode to."""
        return PosedFrames(self.frames.root, decoded(prior, self.frames.z, self.residual), self.frames.transl)

    def retract(self, step: Array) -> CalibrationState:
        """Return the state moved by a (1, 10 + 3 L + n F) step: shape, places, and the frames one after the other."""
        xp, count = array_namespace(step), self.frames.z.shape[0]
        shared = 10 + 3 * len(self.subject.landmarks)
        by_frame = xp.reshape(step[0, shared:], (count, -1))
        return replace(
            self,
            subject=moved(self.subject, step[0, :shared]),
            frames=self.frames.retract(by_frame, self.layout),
            residual=self.residual + rotations_of(by_frame, self.layout, self.residual.shape[1]),
        )
