"""Define the result that every baseline returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from solver_backend.types import Capture, Motion


@dataclass(frozen=True)
class BaselineResult:
    """Result of a baseline for F frames."""

    keypoints3d: np.ndarray  # (F, K, 3) world metres in the capture's joint set, NaN for points without an estimate.
    motion: Motion | None = None  # Animated body, if the method has one.
    statistics: dict[str, Any] = field(default_factory=dict)  # Statistics of the method, as plain values.


class Baseline(ABC):
    """A method to compare with."""

    name: str  # Name in tables.
    simplified: str  # Differences from the publication in a sentence, empty if there are none.

    @abstractmethod
    def solve(self, capture: Capture) -> BaselineResult:
        """Solve a multi-view capture.

        Raises:
            TooFewViews, NoDetections: nothing can be triangulated.
        """
