"""Published and common methods under one interface, to compare a solve with in one run."""

from solver_backend.baselines.base import Baseline, BaselineResult
from solver_backend.baselines.bundlemocap import BundleMoCap, BundleMoCapPlusPlus
from solver_backend.baselines.marker_fits import AdaptiveRobust, MoSh
from solver_backend.baselines.muvs import DCT, MuVS
from solver_backend.baselines.triangulated import TriangulatedButterworth
from solver_backend.baselines.whole_sequence import DMMR, ETC

__all__ = [
    "DCT",
    "DMMR",
    "ETC",
    "AdaptiveRobust",
    "Baseline",
    "BaselineResult",
    "BundleMoCap",
    "BundleMoCapPlusPlus",
    "MoSh",
    "MuVS",
    "TriangulatedButterworth",
]
