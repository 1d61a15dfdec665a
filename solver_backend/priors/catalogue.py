"""Every prior by its name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import get_args

from solver_backend.exchange.errors import WeightsInvalid
from solver_backend.priors.base import PosePrior
from solver_backend.priors.gaussian_vae import VaeName, load_vae
from solver_backend.priors.gmm import load_gmm
from solver_backend.priors.lie_vae import load_lie_vae
from solver_backend.priors.pose_ndf.pose_ndf import load_pose_ndf
from solver_backend.priors.sposer import load_sposer
from solver_backend.priors.svae import load_svae
from solver_backend.priors.weights import ASSETS

LOADERS: dict[str, Callable[[Path], PosePrior]] = {
    "sposer": load_sposer,
    **{name: partial(load_vae, name) for name in get_args(VaeName)},
    "svae": load_svae,
    "lie_vae": load_lie_vae,
    "gmm": load_gmm,
    "pose_ndf": load_pose_ndf,
}
"""What loads the weights of each prior."""


def load_prior(name: str, path: Path | None = None) -> PosePrior:
    """Load a prior's weights, those that ship unless a file is given.

    Raises:
        WeightsInvalid: there is no prior of this name, or the file is not for it.
        FileMissing: there is no such file.
    """
    if name not in LOADERS:
        raise WeightsInvalid(f"There is no prior {name!r} (known: {', '.join(LOADERS)}).")
    return LOADERS[name](path or ASSETS / f"{name}.npz")


def shipped_priors() -> list[str]:
    """Return the names of the priors whose weights are here."""
    return [name for name in LOADERS if (ASSETS / f"{name}.npz").is_file()]
