"""Published and common methods behind a common interface, to compare them with a solve in one run."""

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
