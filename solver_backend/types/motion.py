"""Define the solved motion of a body, and hand motions recorded by gloves."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from solver_backend.exchange.body_layout import SMPL, BodyLayout
from solver_backend.exchange.contact_parts import CONTACT_PARTS
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.joint_sets import JointSet
from solver_backend.exchange.plausible import require_motion
from solver_backend.exchange.props import Prop, require_length
from solver_backend.types.shapes import Bool, Float, Int


@dataclass(frozen=True)
class Motion:
    """An animated body with F frames, in metres and radians, in a world with Z up.

    ``x_world = R(global_orient) (x_body - J_0(betas)) + J_0(betas) + transl`` (SMPL's convention, Loper et al. 2015).
    """

    betas: Float[np.ndarray, " 10"]
    """(10,) shape coefficients."""
    global_orient: Float[np.ndarray, "frames 3"]
    """(F, 3) rotation vectors from body to world."""
    body_pose: Float[np.ndarray, "frames turns"]
    """(F, 3 (J - 1)) rotation vectors of the joints after the root."""
    transl: Float[np.ndarray, "frames 3"]
    """(F, 3) translations in metres."""
    fps: float
    body: str
    """Id of the body."""
    joints: Float[np.ndarray, "frames joints 3"]
    """(F, J, 3) joint positions in world metres."""
    body_layout: BodyLayout = SMPL
    """Joint names and joint tree of the body."""
    keypoints3d: Float[np.ndarray, "frames keypoints 3"] | None = None
    """(F, K, 3) observed keypoints in world metres."""
    joint_set: JointSet | None = None
    """Joint set of ``keypoints3d``."""
    joint_sigma: Float[np.ndarray, "frames joints"] | None = None
    """(F, J) standard deviation of each joint position in metres, RMS over the axes."""
    joint_covariance: Float[np.ndarray, "frames joints 6"] | None = None
    """(F, J, 6) covariance of each joint position in m²: xx, xy, xz, yy, yz, zz in world axes."""
    turn_covariance: Float[np.ndarray, "frames segments 6"] | None = None
    """(F, S, 6) covariance of each segment's rotation in rad² (see ``biomechanics.segments.turn_covariance``)."""
    keyframes: Bool[np.ndarray, " frames"] | None = None
    """(F,) bool, True at the solver's keyframes."""
    contacts: Bool[np.ndarray, "frames 2"] | None = None
    """(F, 2) bool, True while the left or right foot is on the floor."""
    touches: Bool[np.ndarray, "frames 11"] | None = None
    """(F, 11) bool, body parts on the floor (``CONTACT_PARTS``), or None if only feet are known."""
    flags: Int[np.ndarray, " frames"] | None = None
    """(F,) uint8 bit mask of the FLAG_* constants for each frame."""
    resting: Bool[np.ndarray, "frames joints"] | None = None
    """(F, J) bool, True for joints that are shown at rest because nothing was measured. None if all are measured."""
    root: Float[np.ndarray, "frames 3"] | None = None
    """(F, 3) path of a root bone on the ground: x and y in metres, and heading relative to -Y in radians."""
    reprojection_px: Float[np.ndarray, "views frames keypoints"] | None = None
    """(views, F, K) keypoint reprojection errors in pixels, NaN where undetected."""
    markers: np.ndarray | None = None
    """(F, M, 3) marker positions on the solved body in world metres."""
    marker_labels: tuple[str, ...] | None = None
    """(M,) labels in the recording."""
    marker_residual_mm: np.ndarray | None = None
    """(F, M) distances between recorded and solved markers in millimetres, NaN where missing."""
    marker_flags: np.ndarray | None = None
    """(F, M) uint8 bit mask of the MARKER_* constants: seen, filled, swapped, ghost."""
    marker_sigma: np.ndarray | None = None
    """(M,) standard deviation per axis of each marker around its position on the body, in metres."""
    cleaned_markers: np.ndarray | None = None
    """(F, M, 3) recorded markers in world metres, with swaps corrected and gaps filled."""
    offsets: np.ndarray | None = None
    """(M, 3) offset of each marker from its nominal position in the rest pose, in metres."""
    layout: tuple[str, ...] | None = None
    """(M,) name of the body landmark that each marker is placed on."""
    props: tuple[Prop, ...] = ()
    """Rigid objects that are not part of the person, with F frames each."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Version, weights hash, settings, source files and statistics as plain JSON values."""

    def __post_init__(self) -> None:
        frames, joints = (*np.shape(self.global_orient), 0)[0], self.body_layout.num_joints
        shapes = {"betas": (10,), "global_orient": (frames, 3), "body_pose": (frames, 3 * (joints - 1))}
        shapes |= {"transl": (frames, 3), "joints": (frames, joints, 3), "joint_sigma": (frames, joints)}
        shapes |= {"joint_covariance": (frames, joints, 6), "keyframes": (frames,), "contacts": (frames, 2)}
        shapes |= {"touches": (frames, len(CONTACT_PARTS))}
        shapes |= {"flags": (frames,), "resting": (frames, joints), "root": (frames, 3)}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and np.shape(value) != shape:
                layout = self.body_layout.name
                what = f"{name} has shape {np.shape(value)}, but {shape} is expected of the layout {layout}."
                raise MotionInvalid(what, where="motion")
        for turns in (self.body_pose, self.global_orient):
            require_motion(self, turns, MotionInvalid, "motion")
        require_length(self.props, frames)

    @property
    def num_frames(self) -> int:
        """Number of frames in the motion."""
        return len(self.global_orient)

    def beside_truth(self, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
        """Return the N joints that the motion and the truth have in common.

        The result contains the motion's positions (F, N, 3), the true positions (F, N, 3) and the names.

        Args:
            truth: (F, J, 3) joint positions in metres, in this layout or SMPL's. Other shapes give no joints.
        """
        layout = self.body_layout if truth.shape[1:2] == (self.body_layout.num_joints,) else SMPL
        if truth.shape != (self.num_frames, layout.num_joints, 3):
            return self.joints[:, :0], self.joints[:, :0], ()
        own, theirs = self.body_layout.shared_with(layout)
        return self.joints[:, own], np.asarray(truth)[:, theirs], tuple(layout.joints[j] for j in theirs)

    def require_body(self, body: str, layout: BodyLayout, where: str) -> None:
        """Check that the motion is for this body and layout. Raise MotionInvalid otherwise."""
        self.body_layout.require_same_joints(layout, where)
        if self.body != body:
            hint = "Use the body that the motion was solved with."
            raise MotionInvalid(f"The motion was solved with the body {self.body}, not {body}.", where=where, hint=hint)


@dataclass(frozen=True)
class GloveTake:
    """Hand motions of one take, recorded by gloves in F frames."""

    name: str
    times: Float[np.ndarray, " frames"]  # (F,) increasing seconds from the first frame.
    angles: Float[np.ndarray, "frames 2 a"]  # (F, 2, A) angles in radians (``body.hand_skeleton.ANGLES``), or NaN.
    palms: Float[np.ndarray, "frames 2 3 3"]  # (F, 2, 3, 3) palm rotations in the file's world, NaN if unknown.

    @property
    def sides(self) -> tuple[int, ...]:
        """Indices of the hands with recorded angles: 0 left, 1 right."""
        return tuple(side for side in range(2) if np.isfinite(self.angles[:, side]).any())
