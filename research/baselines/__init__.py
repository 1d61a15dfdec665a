"""Implement published and common methods with one interface, for comparison with the solver."""

from research.baselines.base import Baseline, BaselineResult
from research.baselines.bundlemocap import BundleMoCap, BundleMoCapPlusPlus
from research.baselines.marker_fits import AdaptiveRobust, MoSh
from research.baselines.muvs import DCT, MuVS
from research.baselines.triangulated import TriangulatedButterworth
from research.baselines.whole_sequence import DMMR, ETC

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
