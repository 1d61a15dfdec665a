"""Define the interface and the result of all baselines."""

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
    """A published or common method that is compared with the solver."""

    name: str  # Name shown in tables.
    simplified: str  # Differences from the publication as a sentence, or "" without differences.

    @abstractmethod
    def solve(self, capture: Capture) -> BaselineResult:
        """Solve a multi-view capture.

        Raises:
            TooFewViews, NoDetections: nothing can be triangulated.
        """
