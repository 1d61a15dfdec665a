"""Published and common methods under one interface, to compare a solve with in one run."""

from solver_backend.fitters.baselines.base import Baseline, BaselineResult
from solver_backend.fitters.baselines.bundlemocap import BundleMoCap, BundleMoCapPlusPlus
from solver_backend.fitters.baselines.muvs import DCT, MuVS
from solver_backend.fitters.baselines.triangulated import TriangulatedButterworth
from solver_backend.fitters.baselines.whole_sequence import DMMR, ETC

__all__ = [
    "DCT",
    "DMMR",
    "ETC",
    "Baseline",
    "BaselineResult",
    "BundleMoCap",
    "BundleMoCapPlusPlus",
    "MuVS",
    "TriangulatedButterworth",
]
