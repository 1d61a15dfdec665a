"""A person as markers show them: shape, and where every marker sits."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from solver_backend.exchange.errors import SubjectInvalid
from solver_backend.exchange.joint_sets import NUM_BETAS
from solver_backend.exchange.plausible import FARTHEST_M, LARGEST_BETA, require_within
from solver_backend.types.shapes import Float

_LEAST_SIGMA_M = 1e-9
"""Of a marker's place; markers are known to a tenth of a millimetre at best."""


@dataclass(frozen=True)
class MarkerSubject:
    """What a subject calibration finds, for takes of the same person in the same markers."""

    body: str
    """Id of the body that the shape belongs to."""
    betas: Float[np.ndarray, " 10"]
    """(10,) shape."""
    labels: tuple[str, ...]
    """M labels, as the recording has them."""
    places: tuple[str, ...]
    """M places of the layouts; ``@`` and a bone's name where a marker of unknown name moves with that bone."""
    offsets: Float[np.ndarray, "markers 3"]
    """(M, 3) metres in the rest frame: how far each marker lies from its place's rule, or from its bone's joint."""
    sigma_m: Float[np.ndarray, " markers"]
    """(M,) standard deviation of each marker around where the body has it, per axis, metres."""
    skin_m: Float[np.ndarray, " markers"]
    """(M,) metres off the skin of the place; NaN where a marker has a bone alone."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Takes, frames and version that it comes from; plain JSON values."""

    def __post_init__(self) -> None:
        count = len(self.labels)
        shapes = {"betas": (NUM_BETAS,), "offsets": (count, 3), "sigma_m": (count,), "skin_m": (count,)}
        for name, shape in shapes.items():
            value = np.asarray(getattr(self, name))
            if value.shape != shape:
                raise SubjectInvalid(f"{name} has shape {value.shape}; {shape} is expected.", where="subject")
            if name != "skin_m" and not np.isfinite(value).all():
                raise SubjectInvalid(f"{name} holds NaN or infinite values.", where="subject")
        require_within("betas", self.betas, LARGEST_BETA, SubjectInvalid, "subject")
        require_within("offsets", self.offsets, FARTHEST_M, SubjectInvalid, "subject")
        if len(self.places) != count or len(set(self.labels)) < count:
            raise SubjectInvalid("Every marker needs one place and a label of its own.", where="subject")
        require_within("sigma_m", self.sigma_m, FARTHEST_M, SubjectInvalid, "subject")
        require_within("skin_m", np.nan_to_num(self.skin_m, nan=0.0), FARTHEST_M, SubjectInvalid, "subject")
        if count and not (np.asarray(self.sigma_m) >= _LEAST_SIGMA_M).all():
            raise SubjectInvalid("sigma_m holds a number that is not positive.", where="subject")
