"""A simulated network that estimates a person from one video: wrong by pose, drifting, jittering and sliding."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.geometry.rotations import exp_so3
from solver_backend.metrics.positions import pa_mpjpe_mm
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.types import Cameras
from solver_backend.types.network_result import NetworkResult
from tests.support.limb_errors import LIMBS

PA_MM, DRIFT_M, JITTER_RAD, SLIDE_M_S = 40.0, 0.11, 0.01, 0.05
"""Mean error after alignment and deviation of the depth, as published for GVHMR (Shen et al. 2024: PA-MPJPE 38.0 mm on
3DPW, root error 11 cm), and of each joint's turn per frame. Feet slide as the place drifts and jitters."""
_BIAS_S = 0.8  # Time over which a wrong pose lasts.
_ACROSS = 0.25  # Drift across the picture, as a share of the drift in depth.


@dataclass(frozen=True)
class SimulatedResult:
    """What the network says, and its joints in the world."""

    result: NetworkResult
    joints: np.ndarray  # (F, 24, 3) metres in the world of the camera.


def simulate_network(
    body: Body, person: Person, cameras: Cameras, view: int, fps: float, rng: np.random.Generator
) -> SimulatedResult:
    """Return the result of a network on one camera, with ``PA_MM`` of error after alignment.

    The network's body has its mean shape, so sizes are wrong as well.
    """
    count, joints = person.local.shape[:2]
    slow = _slow(rng, (count, joints + 1, 3), _BIAS_S * fps)
    fast = JITTER_RAD * rng.standard_normal(slow.shape)
    R, t = cameras.R[view], cameras.t[view]
    betas = np.zeros(len(person.betas))
    true = np.asarray(forward_kinematics(body, person.betas, person.orient, person.local, person.transl).joints)[:, :24]
    low, high = 0.0, 0.6
    for _ in range(12):
        size = 0.5 * (low + high)
        turns = np.asarray(exp_so3(size * slow + fast))
        root, local = person.orient @ turns[:, 0], person.local @ turns[:, 1:]
        posed = np.asarray(forward_kinematics(body, betas, root, local, person.transl).joints)[:, :24]
        error = pa_mpjpe_mm(posed[:, LIMBS], true[:, LIMBS])
        low, high = (size, high) if error < PA_MM else (low, size)
    drift = DRIFT_M * _slow(rng, (count, 3), 2.0 * fps) * np.array([_ACROSS, _ACROSS, 1.0])
    drift += SLIDE_M_S / fps * rng.standard_normal((count, 3))
    pelvis = np.asarray(body.rest_joints(betas))[0]
    place = (person.transl + np.asarray(body.rest_joints(person.betas))[0]) @ R.T + t + drift
    transl = (place - t) @ R - pelvis
    posed = np.asarray(forward_kinematics(body, betas, root, local, transl).joints)[:, :24]
    in_camera = np.concatenate([(R @ root)[:, None], local[:, :21]], axis=1)
    result = NetworkResult("simulated", "0", np.arange(count), in_camera, None, root, transl)
    return SimulatedResult(result, posed)


def _slow(rng: np.random.Generator, shape: tuple[int, ...], frames: float) -> np.ndarray:
    """Return noise of unit deviation that lasts so many frames, along the first axis."""
    reach = int(3 * frames)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / frames) ** 2)
    kernel /= np.sqrt((kernel**2).sum())
    noise = rng.standard_normal((shape[0] + 2 * reach, int(np.prod(shape[1:]))))
    smooth = np.stack([np.convolve(column, kernel, mode="valid") for column in noise.T], axis=1)
    return smooth.reshape(shape)
