"""Figures of pose priors: sampling, reconstruction, denoising and interpolation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from research.priors import GaussianMixture
from solver_backend.body.joint_limits import excess_deg
from solver_backend.geometry.interpolation import sider2, sider_n, slerp
from solver_backend.geometry.rotations import exp_so3, matrix_from_quat, quat_from_matrix
from solver_backend.metrics import diversity, frechet_distance
from solver_backend.priors.base import PosePrior
from solver_backend.priors.pose_ndf import RECORDED_RAD, PoseNDF, ProjectionSettings
from training.data.balance import bezier, bspline, lerp, squad, squad_controls
from training.data.corpus import Corpus
from training.data.points import rotation_points
from training.engine.accuracy import joint_distances, reconstruction_accuracy

POSE_ITSELF = ("gmm", "pose_ndf")  # Priors with poses as codes, which reconstruct everything exactly.
NOISE_DEG = (5.0, 10.0, 20.0)
NOISY_JOINTS = 20
Table = dict[str, dict[str, float]]
"""Rows of figures by name."""


def features(rotations: np.ndarray) -> np.ndarray:
    """Return (N, 69) positions of joints 1..23 in decimetres, with an unrotated pelvis at the origin."""
    return 10.0 * rotation_points(rotations)[:, 1:24].reshape(len(rotations), -1)


def average_pairwise_mm(f: np.ndarray, seed: int, pairs: int = 3000) -> float:
    """Return the mean joint distance in mm between random pairs of poses."""
    rng = np.random.default_rng(seed)
    joints = f.reshape(len(f), -1, 3)
    first, second = joints[rng.integers(len(f), size=pairs)], joints[rng.integers(len(f), size=pairs)]
    return 100.0 * float(np.linalg.norm(first - second, axis=-1).mean())


def synthesis(rotations: np.ndarray, real: np.ndarray, seed: int) -> dict[str, float]:
    """Return FID, DIV, APD and the share of implausible poses of (N, 21, 3, 3) samples, compared with real features.

    FID and DIV use positions, because no prior was trained to spread these. The thesis uses codes (``code_synthesis``).
    """
    f = features(rotations)
    return {
        "FID": frechet_distance(f, real), "DIV": diversity(f, seed), "APD mm": average_pairwise_mm(f, seed),
        "outside %": 100.0 * float((excess_deg(rotations) > 0).any(axis=1).mean()),
    }  # fmt: skip


def code_synthesis(rotations: np.ndarray, real_codes: np.ndarray, encoder: PosePrior, seed: int) -> dict[str, float]:
    """Return FID and DIV of (N, 21, 3, 3) samples as in the thesis, with the codes of one encoder (VPoser's).

    The paper chooses its model by their quotient (supplement, eq. 17).
    """
    codes = np.asarray(encoder.encode(rotations))
    fid, div = frechet_distance(codes, real_codes), diversity(codes, seed)
    return {"FID codes": fid, "DIV codes": div, "FID / DIV codes": fid / max(div, 1e-9)}


def reconstruction(prior: PosePrior, truth: np.ndarray) -> dict[str, float]:
    """Return the errors of decoded codes of (N, 21, 3, 3) poses, none for a prior with poses as codes."""
    if prior.name in POSE_ITSELF:
        return {}
    decoded = prior.decode(prior.encode(truth))
    found = reconstruction_accuracy(truth, decoded)
    distance = joint_distances(truth, decoded)
    return {
        "MPJPE mm": found.mpjpe_mm, "worst 5 % mm": found.worst5_mpjpe_mm, "PCK3 %": found.pck3_percent,
        "PCK7 %": 100.0 * float((distance < 0.07).mean()), "angle °": found.angle_deg,
    }  # fmt: skip


def noisy(truth: np.ndarray, sigma_deg: float, seed: int) -> np.ndarray:
    """Rotate 20 random joints of every pose by a normal rotation vector with ``sigma_deg`` per axis."""
    rng = np.random.default_rng(seed)
    turn = np.radians(sigma_deg) * rng.standard_normal((len(truth), truth.shape[1], 3))
    spared = np.argsort(rng.random(turn.shape[:2]), axis=1)[:, NOISY_JOINTS:]
    np.put_along_axis(turn, spared[..., None], 0.0, axis=1)
    return exp_so3(turn) @ truth


def denoised(prior: PosePrior, poses: np.ndarray, sigma_deg: float) -> np.ndarray:
    """Return a prior's estimates for noisy poses: its projection, posterior mean or reconstruction."""
    if isinstance(prior, PoseNDF):
        return prior.project(poses, ProjectionSettings(level=RECORDED_RAD))
    if isinstance(prior, GaussianMixture):
        return prior.posterior_mean(poses, np.radians(sigma_deg))
    return prior.decode(prior.encode(poses))


def denoising(prior: PosePrior, truth: np.ndarray, seed: int) -> dict[str, float]:
    """Return, for every noise level, the ratio of the joint error after denoising to the error before."""
    ratios = {}
    for sigma in NOISE_DEG:
        poses = noisy(truth, sigma, seed)
        after = joint_distances(truth, denoised(prior, poses, sigma)).mean()
        ratios[f"σ {sigma:.0f}°"] = float(after / joint_distances(truth, poses).mean())
    return ratios


@dataclass(frozen=True)
class Keys:
    """Four successive keys of motions, and the frame in the middle of each."""

    poses: np.ndarray  # (N, 4, 21, 3, 3) rotations of the keys.
    middle: np.ndarray  # (N, 21, 3, 3) rotations halfway between the second and the third key.


def draw_keys(corpus: Corpus, spacing: int, count: int, seed: int) -> Keys:
    """Return keys around random frames of a corpus, ``spacing`` frames apart (an even number)."""
    reach = spacing + spacing // 2
    frame = np.arange(corpus.num_frames)
    frame = frame[(frame - reach >= corpus.clip_start) & (frame + reach < corpus.clip_end)]
    frame = np.random.default_rng(seed).choice(frame, min(count, len(frame)), replace=False)
    at = frame[:, None] + np.array([-reach, -spacing // 2, spacing // 2, reach])
    R = corpus.rotations.astype(np.float64)
    return Keys(R[at], R[frame])


Scheme = Callable[[np.ndarray], np.ndarray]  # Returns the (N, d) middle point of (N, 4, d) unit keys.


def _squad(k: np.ndarray) -> np.ndarray:
    controls = squad_controls(k)
    return squad(k[:, 1], k[:, 2], controls[:, 1], controls[:, 2], 0.5)


SCHEMES: dict[str, Scheme] = {
    "LERP": lambda k: lerp(k[:, 1], k[:, 2], 0.5),
    "SLERP": lambda k: slerp(k[:, 1], k[:, 2], 0.5),
    "SQUAD": _squad,
    "Bezier": lambda k: bezier(k[:, 0], k[:, 1], k[:, 2], k[:, 3], 0.5),
    "B-spline": lambda k: bspline(k[:, 0], k[:, 1], k[:, 2], k[:, 3], 0.5),
    "SIDER2": lambda k: sider2(k[:, 0], k[:, 1], k[:, 2], 0.75),
    "SIDER3": lambda k: sider_n(k, 0.5),
}
"""Interpolations of the middle frame. LERP and SLERP use two keys, SIDER2 three, the others four."""


def interpolation(prior: PosePrior | None, keys: Keys) -> dict[str, float]:
    """Return the middle frame's joint error in mm by scheme, for interpolated codes, or quaternions without a prior."""
    count = len(keys.poses)
    if prior is None:
        return {name: _error_mm(keys, _in_quaternions(keys.poses, scheme)) for name, scheme in SCHEMES.items()}
    codes = prior.encode(keys.poses.reshape(-1, 21, 3, 3)).reshape(count, 4, -1)
    lengths = np.linalg.norm(codes, axis=-1, keepdims=True)
    length = 0.5 * (lengths[:, 1] + lengths[:, 2])
    return {
        name: _error_mm(keys, prior.decode(length * _unit(scheme(codes / lengths)))) for name, scheme in SCHEMES.items()
    }


def _in_quaternions(poses: np.ndarray, scheme: Scheme) -> np.ndarray:
    quats = quat_from_matrix(poses)
    for k in range(1, 4):
        flip = (quats[:, k] * quats[:, k - 1]).sum(-1, keepdims=True) < 0
        quats[:, k] = np.where(flip, -quats[:, k], quats[:, k])
    flat = np.moveaxis(quats, 1, 2).reshape(-1, 4, 4)
    return matrix_from_quat(_unit(scheme(flat))).reshape(len(poses), 21, 3, 3)


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.linalg.norm(x, axis=-1, keepdims=True)


def _error_mm(keys: Keys, decoded: np.ndarray) -> float:
    return 1000.0 * float(joint_distances(keys.middle, decoded).mean())


def text_table(title: str, rows: Table) -> str:
    """Return rows of figures as a Markdown table."""
    columns = list(dict.fromkeys(name for row in rows.values() for name in row))
    lines = [f"{title}\n", "| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for name, row in rows.items():
        cells = (f"{row[c]:.2f}" if c in row else "–" for c in columns)
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"
