"""Published and common methods under one interface, to compare a solve with in one run."""

from solver_backend.fitters.baselines.base import Baseline, BaselineResult
from solver_backend.fitters.baselines.bundlemocap import BundleMoCap, BundleMoCapPlusPlus
from solver_backend.fitters.baselines.per_frame import PerFrame
from solver_backend.fitters.baselines.triangulated import TriangulatedButterworth

__all__ = [
    "Baseline",
    "BaselineResult",
    "BundleMoCap",
    "BundleMoCapPlusPlus",
    "PerFrame",
    "TriangulatedButterworth",
]
