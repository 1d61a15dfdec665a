"""Named errors of detectors."""

from __future__ import annotations

from solver_backend.exchange.errors import MocapError


class DetectorMissing(MocapError):
    """No detector is installed, or the Python or model that was named has none."""

    code = "detector_missing"


class DetectorOutputsUnknown(MocapError):
    """A model's inputs and outputs are of no kind we can read."""

    code = "detector_outputs_unknown"


class DetectorFailed(MocapError):
    """The detector's process broke."""

    code = "detector_failed"
