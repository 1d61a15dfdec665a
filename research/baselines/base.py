"""Define the result that all baselines return."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from solver_backend.types import Capture, Motion


@dataclass(frozen=True)
class BaselineResult:
    """Result of a baseline over F frames."""

    keypoints3d: np.ndarray  # (F, K, 3) world metres in the capture's joint set, NaN where there is no estimate.
    motion: Motion | None = None  # The animated body, if the method estimates one.
    statistics: dict[str, Any] = field(default_factory=dict)  # Statistics that the method reports, as plain values.


class Baseline(ABC):
    """A method to compare a solve with."""

    name: str  # Name shown in tables.
    simplified: str  # A sentence about differences from the publication, or "" if there are none.

    @abstractmethod
    def solve(self, capture: Capture) -> BaselineResult:
        """Solve a multi-view capture.

        Raises:
            TooFewViews, NoDetections: nothing can be triangulated.
        """
