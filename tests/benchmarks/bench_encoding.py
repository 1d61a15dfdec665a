"""Thesis table 6.5 with equal controls: each encoder alone, and with one Gauss-Newton step (``sposer.nearer_codes``).

The shipped weights encode and decode 1,052 held-out poses, as in `bench autoencoders`. The figure is the mean joint
error. Needs the validation motions (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

from solver_backend.priors.gaussian_vae import load_vae
from solver_backend.priors.sposer import load_sposer, nearer_codes
from tests.benchmarks.bench_autoencoders import held_out_poses
from tests.benchmarks.metric import Metric
from training.engine.accuracy import reconstruction_accuracy


def run() -> list[Metric]:
    """Encode and decode the poses."""
    poses, sposer = held_out_poses(), load_sposer()
    alone, stepped = {"sposer": sposer.decode(sposer.guess(poses))}, {"sposer": sposer.decode(sposer.encode(poses))}
    for name in ("vposer", "rvposer"):
        prior = load_vae(name)
        codes = prior.encode(poses)
        alone[name] = prior.decode(codes)
        stepped[name] = prior.decode(nearer_codes(prior.decode_with_jacobian, poses, codes))
    return [
        Metric(f"{name}_{kind}_mpjpe_mm", reconstruction_accuracy(poses, found).mpjpe_mm, "mm")
        for kind, rows in (("alone", alone), ("step", stepped))
        for name, found in rows.items()
    ]
