"""A moving stick figure before four cameras: true keyframes, noisy detections, and a start a little off."""

import numpy as np

from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.cameras.projection import project
from solver_backend.fitters.keyframes.normal_equations import (
    BundleModel,
    BundleObjective,
    KeyTerm,
    ResidualRotationTerm,
)
from solver_backend.fitters.model.keyframe_curve import key_poses
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.subject import (
    FrameObjective,
    Keyframes,
    PosedFrames,
    Subject,
    hemisphere_aligned,
    pose,
)
from solver_backend.geometry.arrays import constant
from solver_backend.geometry.interpolation import spherical_normalisation
from solver_backend.residuals.pose_mixture import PoseMixtureTerm
from solver_backend.residuals.reprojection import ReprojectionTerm
from solver_backend.synthesis.embedded.demo import tripods
from solver_backend.types import JointSet, Keypoints2D
from tests.support.layouts import LAYOUTS, ON_MANIFOLD
from tests.support.stick_body import stick_body
from tests.support.toy_prior import ToyPrior

FRAMES, WINDOW, NOISE_PX = 61, 20, 2.0
NO_PERSON = (PoseMixtureTerm(weight=0.0),)
"""The made-up decoder's poses are no people's: what people's poses are like has no say."""
ROTATIONS = ResidualRotationTerm(np.full((21, 3), 0.05))


class StickScene:
    """Truth, detections and a start a little off."""

    def __init__(self, like=np.zeros(1)) -> None:
        rng = np.random.default_rng(11)
        self.body, self.prior = stick_body(), ToyPrior()
        self.layout = KeyframeLayout.even(FRAMES, WINDOW)
        count = self.layout.num_keys
        walk = np.cumsum(rng.normal(size=(count, 32)), axis=0)
        z = spherical_normalisation(rng.normal(size=32) * 3 + walk * 0.5)
        turn = np.cumsum(0.1 * rng.normal(size=count))
        half = (np.pi / 2 * np.ones(count)) / 2
        quat = np.stack([np.cos(half), np.sin(half), 0 * half, turn * 0.3], 1)
        quat /= np.linalg.norm(quat, axis=1, keepdims=True)
        transl = np.array([0, 0, 0.95]) + np.cumsum(0.04 * rng.normal(size=(count, 3)), 0)
        self.truth = hemisphere_aligned(Keyframes(z, quat, transl, np.zeros((count, 21, 3))))
        landmarks = keypoint_landmarks(self.body, JointSet.SMPL_24)
        self.subject = Subject(self.body, landmarks, constant(np.zeros(10), like), constant(np.zeros((24, 3)), like))
        exact = Subject(self.body, landmarks, np.zeros(10), np.zeros((24, 3)))
        self.points = pose(exact, key_poses(self.prior, self.truth, self.layout, residuals=False)).points
        cameras = tripods(np.array([0.0, 0.0, 0.95]))
        px = project(cameras, self.points)
        px = px + NOISE_PX * rng.normal(size=px.shape)
        wrong = rng.random(px.shape[:-1]) < 0.03
        px[wrong] += 80 * rng.choice([-1, 1], (wrong.sum(), 2))
        self.keypoints = Keypoints2D(px, np.ones(px.shape[:-1]), JointSet.SMPL_24, 60.0)
        self.cameras = cameras
        self.term = ReprojectionTerm.of(cameras, self.keypoints, np.full(24, NOISE_PX), like)
        off = 0.03 * rng.normal(size=(count, 36))
        off[0] = 0
        start = self.truth.retract(off, ON_MANIFOLD)
        self.start = Keyframes(*(constant(getattr(start, n), like) for n in ("z", "quat", "transl", "residual")))

    @property
    def objective(self) -> FrameObjective:
        return FrameObjective((self.term,), NO_PERSON)

    def model(self, *keys: KeyTerm) -> BundleModel:
        free = LAYOUTS[any(isinstance(term, ResidualRotationTerm) for term in keys)]
        return BundleModel(self.subject, self.prior, BundleObjective(self.objective, keys), free)

    def data(self, *, residuals: bool) -> BundleModel:
        return BundleModel(self.subject, self.prior, BundleObjective(self.objective), LAYOUTS[residuals])

    def poses(self, keys: Keyframes) -> PosedFrames:
        return key_poses(self.prior, keys, self.layout, residuals=True)

    def error_mm(self, keys) -> float:
        solved = np.asarray(pose(self.subject, self.poses(keys)).points)
        return 1000 * float(np.linalg.norm(solved - self.points, axis=-1).mean())
