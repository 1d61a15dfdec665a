"""Bring your own pose prior: ``python docs/examples/own_prior.py CAPTURE MOTION.npz``.

Any prior with codes on SPoser's sphere works. You can load your own weights with ``load_sposer(path)``. This example
adds knowledge to SPoser: the person wears wrist braces.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend import AutoencodingPrior, load_capture, load_sposer, solve, write_motion

WRISTS = [19, 20]
"""Indices of the wrists among the 21 body joints, which start with the left hip."""


class WristsInBraces(AutoencodingPrior):
    """SPoser with straight wrists."""

    name = "sposer_in_braces"
    latent_dim = 32

    def __init__(self) -> None:
        self._sposer = load_sposer()
        self.metadata: dict[str, Any] = {}
        self.residual_sigma = self._sposer.residual_sigma.copy()
        self.residual_sigma[WRISTS] = np.deg2rad(1.0)

    def encode(self, rotations: Any) -> Any:
        """Return SPoser's codes."""
        return self._sposer.encode(rotations)

    def decode(self, z: Any) -> Any:
        """Return SPoser's poses with straight wrists."""
        return self._straightened(self._sposer.decode(z))

    def decode_with_jacobian(self, z: Any) -> tuple[Any, Any]:
        """Return poses and their derivative. The code does not move the wrists."""
        rotations, jacobian = self._sposer.decode_with_jacobian(z)
        jacobian[:, WRISTS] = 0.0
        return self._straightened(rotations), jacobian

    def energy(self, rotations: Any) -> Any:
        """Return SPoser's energy."""
        return self._sposer.energy(rotations)

    def sample(self, count: int, seed: int) -> Any:
        """Return SPoser's samples with straight wrists."""
        return self._straightened(self._sposer.sample(count, seed))

    def _straightened(self, rotations: Any) -> Any:
        rotations[:, WRISTS] = np.eye(3)
        return rotations


def main(capture_path: str, motion_path: str) -> None:
    """Solve with straight wrists."""
    motion = solve(load_capture(capture_path), prior=WristsInBraces()).motion
    write_motion(Path(motion_path), motion)
    wrists = motion.body_pose.reshape(motion.num_frames, -1, 3)[:, WRISTS]
    print(f"The wrists bend by {np.rad2deg(np.linalg.norm(wrists, axis=-1)).max():.1f} degrees at most.")


if __name__ == "__main__":
    main(*sys.argv[1:])
