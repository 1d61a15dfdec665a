"""The unknowns of a calibration: shape, places of the markers, and the poses of the frames that are looked at."""

from __future__ import annotations

from dataclasses import dataclass, replace

from array_api_compat import array_namespace

from solver_backend.fitters.model.codes import decoded
from solver_backend.fitters.model.frame_states import FrameStates
from solver_backend.fitters.model.posed_frames import PosedFrames
from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.model.tangent import KEY
from solver_backend.fitters.subject_calibration.shape import moved
from solver_backend.geometry.arrays import Array, zeros
from solver_backend.priors.base import PosePrior
from solver_backend.types import NUM_BODY_JOINTS


@dataclass(frozen=True)
class CalibrationState:
    """A person and F poses, which may leave the prior's manifold as they may in the bundle."""

    subject: Subject
    """The person."""
    frames: FrameStates
    """Codes, roots and translations."""
    residual: Array
    """(F, 21, 3) rotation vectors by which joints leave the manifold."""

    @classmethod
    def of(cls, subject: Subject, frames: FrameStates) -> CalibrationState:
        """Return the state of poses on the manifold."""
        return cls(subject, frames, zeros((frames.z.shape[0], NUM_BODY_JOINTS, 3), frames.z))

    def poses(self, prior: PosePrior) -> PosedFrames:
        """Return the poses that the states decode to."""
        return PosedFrames(self.frames.root, decoded(prior, self.frames.z, self.residual), self.frames.transl)

    def retract(self, step: Array) -> CalibrationState:
        """Return the state moved by a (1, 10 + 3 L + 99 F) step: shape, places, and the frames one after the other."""
        xp, count = array_namespace(step), self.frames.z.shape[0]
        shared = 10 + 3 * len(self.subject.landmarks)
        by_frame = xp.reshape(step[0, shared:], (count, -1))
        turned = self.residual + xp.reshape(by_frame[:, KEY.residual], self.residual.shape)
        return replace(
            self,
            subject=moved(self.subject, step[0, :shared]),
            frames=self.frames.retract(by_frame[:, : KEY.dof()]),
            residual=turned,
        )
