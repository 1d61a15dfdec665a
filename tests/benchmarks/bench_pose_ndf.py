"""Tables of Pose-NDF's paper (Tiwari et al. 2022, sec. 4) on takes of subjects that no prior was trained on.

Figures are mean errors of the skin's vertices in every fifth frame, with known root, at 30 frames per second.
Denoising: recorded takes without changes, and with every joint rotated by Gaussian noise of 6.5 degrees about each axis
(the paper's noise is 9.3 cm). Completion: a limb's joints are unknown. The comparison is with VPoser (as in its public
code and as in the thesis) and RVPoser by the paper's eq. 9, and with no prior (for completion, the limb at rest).
Keypoints: ten frames of a take in front of one known camera, 25 keypoints with 5 px of noise, from rest poses rotated
by 15 degrees (eqs. 10 and 11, with the error after the best similarity). Interpolation: movement of the vertices per
frame. Samples: average pairwise distance of joints, joints beyond their range of motion, and poses with limbs and trunk
intersecting by more than 3 cm, measured with capsules, compared with recorded poses. Pictures are written to
build/bench_pose_ndf.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from research.priors import load_gmm
from solver_backend.body.body import load_body
from solver_backend.body.joint_limits import excess_deg
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.markers import marker_landmarks, marker_layout
from solver_backend.body.mesh import pose_mesh
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.fitters.pose_ndf.complete import (
    ALONG,
    WEIGHTS,
    DenoiseSettings,
    KeypointSettings,
    ManifoldWeights,
    complete,
    denoise,
    interpolate_poses,
    missing_joints,
)
from solver_backend.fitters.pose_ndf.edit_motion import LAYOUT
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.metrics.self_intersection import self_intersection_percent
from solver_backend.priors.gaussian_vae import VaeName, load_vae
from solver_backend.priors.pose_ndf import load_pose_ndf
from tests.benchmarks.comparison.validation_takes import clip_paths, read_take, take_named
from tests.benchmarks.metric import Metric
from tests.benchmarks.pose_priors.keypoint_fits import latent_fit, manifold_fit, sighting
from tests.benchmarks.pose_priors.latent_chain import LatentChain
from tests.benchmarks.pose_priors.pose_pictures import draw_strips

TAKES = (("03_03", 120), ("03_04", 1200), ("13_29", 900), ("salsa_07", 60))
"""Held-out takes, and the first frame at 60 Hz."""
LENGTHS = (60, 120)
NOISE_DEG, FPS = 6.5, 30.0
OCCLUSIONS = {
    "leg": ("left_leg",), "arm": ("left_arm",), "shoulder_upper_arm": ("right_collar", "right_shoulder"),
}  # fmt: skip
KEYPOINT_SETTINGS = KeypointSettings(manifold=100.0, robust_scale=20.0, iterations=30)
VAES: tuple[VaeName, ...] = ("vposer", "vposer_worded", "rvposer")
"""VPoser as in its public code, as in the thesis, and RVPoser."""
CONSTANT_WEIGHT, PULLS = 30.0, {"vposer": 20.0, "vposer_worded": 20.0, "rvposer": 10.0}
"""Weights λ_θ of the fits to keypoints, the best of several on training takes (``pose_priors/tune_pulls.py``)."""
PICTURES = Path(__file__).resolve().parents[2] / "build" / "bench_pose_ndf"
_BODY = load_body()
_NAMES = marker_layout(LAYOUT)
SUBJECT = Subject(_BODY, marker_landmarks(_BODY, _NAMES), np.zeros(10), np.zeros((len(_NAMES), 3)))
"""The mean body. Applications of the field observe its markers."""


def run() -> list[Metric]:
    """Make all tables and the pictures."""
    prior, vaes = load_pose_ndf(), {name: load_vae(name) for name in VAES}
    takes = {length: [_take(name, start, length) for name, start in TAKES] for length in LENGTHS}
    metrics: list[Metric] = []
    shown: dict[str, np.ndarray] = {}
    for length, cut in takes.items():
        metrics += _denoising(prior, vaes, cut, length, shown)
        metrics += _completion(prior, vaes, cut, length, shown)
    metrics += _keypoints(prior, vaes, takes[LENGTHS[0]])
    metrics += _interpolation(prior, vaes, takes[LENGTHS[0]], shown)
    metrics += _samples(prior, vaes, shown)
    draw_strips(_BODY, shown, PICTURES)
    return metrics


def _take(name: str, start: int, length: int) -> PosedFrames:
    take = take_named(name, 2 * length, start)
    rotations = take.rotations[::2]
    return PosedFrames(rotations[:, 0], rotations[:, 1:22], take.root[::2])


def _denoising(prior, vaes, takes, length, shown) -> list[Metric]:
    rng = np.random.default_rng(length)
    errors: dict[str, list[float]] = {}
    for truth in takes:
        turn = exp_so3(np.radians(NOISE_DEG) * rng.standard_normal(truth.local.shape[:2] + (3,)))
        noisy = PosedFrames(truth.root, turn @ truth.local, truth.transl)
        errors.setdefault("noise", []).append(error_cm(noisy, truth))
        for data, start in (("clean", truth), ("noisy", noisy)):
            for row, work in (
                ("no_prior", partial(_denoised, prior, ManifoldWeights(1.0, 0.0, WEIGHTS.smoothness))),
                *((name, partial(_latent_denoised, vae)) for name, vae in vaes.items()),
                ("pose_ndf", partial(_denoised, prior, WEIGHTS)),
            ):
                found = work(start)
                errors.setdefault(f"{data}_{row}", []).append(error_cm(found, truth))
                if data == "noisy" and row != "no_prior":
                    shown.setdefault("truth", truth.local[::10])
                    shown.setdefault("noisy", noisy.local[::10])
                    shown.setdefault(f"denoised_{row}", found.local[::10])
    return [Metric(f"denoise_{length}_{key}_cm", float(np.mean(v)), "cm", rel_tol=0.1) for key, v in errors.items()]


def _denoised(prior, weights: ManifoldWeights, noisy: PosedFrames) -> PosedFrames:
    return denoise(SUBJECT, prior, noisy, FPS, DenoiseSettings(weights, iterations=12, move_root=False))


def _latent_denoised(vae, noisy: PosedFrames) -> PosedFrames:
    observed = pose(SUBJECT, noisy).points
    chain = LatentChain(
        SUBJECT, vae, noisy.root, noisy.transl, observed, np.ones(observed.shape[:2]), vae.encode(noisy.local),
        pull=1e-4, smoothness=3e-3,
    )  # fmt: skip
    return PosedFrames(noisy.root, chain.solve(), noisy.transl)


def _completion(prior, vaes, takes, length, shown) -> list[Metric]:
    errors: dict[str, list[float]] = {}
    for truth in takes:
        for name, limbs in OCCLUSIONS.items():
            missing = missing_joints(limbs)
            rest = truth.local.copy()
            rest[:, list(missing)] = np.eye(3)
            hidden = PosedFrames(truth.root, rest, truth.transl)
            found = {
                "rest": hidden,
                **{name: _latent_completed(vae, hidden, missing) for name, vae in vaes.items()},
                "pose_ndf": complete(SUBJECT, prior, hidden, missing, FPS),
            }
            for row, frames in found.items():
                errors.setdefault(f"{name}_{row}", []).append(error_cm(frames, truth))
                shown.setdefault(f"complete_{name}_truth", truth.local[::10])
                shown.setdefault(f"complete_{name}_{row}", frames.local[::10])
    return [Metric(f"complete_{length}_{key}_cm", float(np.mean(v)), "cm", rel_tol=0.15) for key, v in errors.items()]


def _latent_completed(vae, hidden: PosedFrames, missing: tuple[int, ...]) -> PosedFrames:
    """Fit codes to the landmarks that the missing joints do not move, and take the missing joints from them."""
    posed = pose(SUBJECT, hidden, jacobian=True)
    assert posed.by_rotations is not None
    columns = [3 + 3 * j + axis for j in missing for axis in range(3)]
    seen = (np.abs(posed.by_rotations[..., columns]).max(axis=(2, 3)) < 1e-6).astype(float)
    chain = LatentChain(
        SUBJECT, vae, hidden.root, hidden.transl, posed.points, seen, vae.encode(hidden.local), pull=1e-4,
        smoothness=3e-3,
    )  # fmt: skip
    decoded, local = chain.solve(), hidden.local.copy()
    local[:, list(missing)] = decoded[:, list(missing)]
    return PosedFrames(hidden.root, local, hidden.transl)


def _interpolation(prior, vaes, takes, shown, pairs: int = 40, count: int = 10) -> list[Metric]:
    poses, rng = np.concatenate([t.local for t in takes]), np.random.default_rng(0)
    start, end = poses[rng.permutation(len(poses))[:pairs]], poses[rng.permutation(len(poses))[:pairs]]
    share = np.linspace(0.0, 1.0, count + 2)
    ends = prior.project(start, ALONG)[:, None], prior.project(end, ALONG)[:, None]
    turn = log_so3(end @ np.swapaxes(start, -1, -2))[:, None]
    ways = {
        "pose_ndf": np.concatenate([ends[0], interpolate_poses(prior, start, end, count), ends[1]], axis=1),
        **{name: _latent_way(vae, start, end, share) for name, vae in vaes.items()},
        "slerp": exp_so3(share[:, None, None] * turn) @ start[:, None],
    }
    metrics = []
    for row, way in ways.items():
        shown[f"between_{row}"] = way[0]
        vertices = np.stack([_vertices(w) for w in way])
        steps = 100 * np.linalg.norm(np.diff(vertices, axis=1), axis=-1).mean(axis=-1)
        metrics += [
            Metric(f"interpolate_{row}_mean_cm", float(steps.mean()), "cm", rel_tol=0.1),
            Metric(f"interpolate_{row}_std_cm", float(steps.std()), "cm", rel_tol=0.1),
            Metric(
                f"interpolate_{row}_uneven", float((steps.std(axis=1) / steps.mean(axis=1)).mean()), "", rel_tol=0.2
            ),
        ]
    return metrics


def _latent_way(vae, start: np.ndarray, end: np.ndarray, share: np.ndarray) -> np.ndarray:
    codes = [vae.encode(x)[:, None] for x in (start, end)]
    way = (1 - share[:, None]) * codes[0] + share[:, None] * codes[1]
    return vae.decode(way.reshape(-1, way.shape[-1])).reshape(*way.shape[:2], 21, 3, 3)


def _keypoints(prior, vaes, takes) -> list[Metric]:
    mixture = load_gmm()
    rest = mixture.decode(mixture.mean[None])[0]
    seen = [sighting(take.select(slice(0, None, 6)), rest, seed) for seed, take in enumerate(takes)]
    settings = KEYPOINT_SETTINGS
    rows = {
        "no_prior": partial(manifold_fit, prior, settings=replace(settings, manifold=0.0)),
        "pose_ndf_constant": partial(
            manifold_fit, prior, settings=replace(settings, adaptive=False, manifold=CONSTANT_WEIGHT)
        ),
        "pose_ndf": partial(manifold_fit, prior, settings=settings),
        **{name: partial(latent_fit, vae, pull=PULLS[name], settings=settings) for name, vae in vaes.items()},
    }
    return [
        Metric(f"keypoints_{name}_mm", float(np.mean([fit(seen=s) for s in seen])), "mm", rel_tol=0.1)
        for name, fit in rows.items()
    ]


def _samples(prior, vaes, shown, count: int = 500) -> list[Metric]:
    metrics, drawn = [], {"pose_ndf": prior, **vaes, "gmm": load_gmm()}
    poses = {row: np.asarray(source.sample(count, 0)) for row, source in drawn.items()}
    recorded = np.concatenate([read_take(path).rotations[::4, 1:22] for path in clip_paths()])
    poses["recorded"] = recorded[np.random.default_rng(0).permutation(len(recorded))[:count]]
    for row, local in poses.items():
        shown[f"samples_{row}"] = local[:12]
        root, transl = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
        joints = forward_kinematics(_BODY, np.zeros(10), root, local, transl).joints
        apart = np.mean([np.linalg.norm(joints - joints[i], axis=-1).mean() for i in range(count)])
        outside = (excess_deg(local) > 0).any(axis=1).mean()
        metrics += [
            Metric(f"samples_{row}_apd_cm", 100 * float(apart) * count / (count - 1), "cm", "higher"),
            Metric(f"samples_{row}_outside_percent", 100 * float(outside), "%", abs_tol=0.5),
            Metric(f"samples_{row}_intersecting_percent", self_intersection_percent(_BODY, joints), "%", abs_tol=0.5),
        ]
    return metrics


def error_cm(found: PosedFrames, truth: PosedFrames) -> float:
    """Return the mean error of the skin's vertices in every fifth frame, in cm."""
    difference = _vertices(found.local[::5]) - _vertices(truth.local[::5])
    return 100 * float(np.linalg.norm(difference, axis=-1).mean())


def _vertices(local: np.ndarray) -> np.ndarray:
    """Return the skin with an unrotated pelvis at the origin, so that distances are those with a known root."""
    root = np.tile(np.eye(3), (len(local), 1, 1))
    return pose_mesh(_BODY, np.zeros(10), root, local, np.zeros((len(local), 3)))
