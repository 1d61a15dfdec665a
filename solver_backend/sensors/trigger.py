"""Sensors that one wire triggers: in step, but for the microseconds by which their light must not overlap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.exchange.errors import CommandLineInvalid
from solver_backend.videos.sync.clocks import Clocks

INTERLEAVE_S = 160e-6
"""By how much each time-of-flight sensor exposes later than the one before, so that its light does not reach another
(thesis 5.3.2, after the Azure Kinect's documentation)."""
LARGEST_INTERLEAVE_S = 0.02
"""Seconds between two sensors' exposures at most; chosen by hand."""


def triggered(names: tuple[str, ...], interleave_s: float = 0.0) -> Clocks:
    """Return the clocks of sensors on one trigger: sensor c exposes ``c · interleave`` later than the first.

    Stamps are the trigger's: what a sensor shows at stamp t happened at ``t + c · interleave``.

    Args:
        names: of the sensors, in the order of their delays.
        interleave_s: seconds; ``INTERLEAVE_S`` for time-of-flight sensors, 0 for others.

    Raises:
        CommandLineInvalid: the interleave is negative or longer than a frame.
    """
    if not 0.0 <= interleave_s <= LARGEST_INTERLEAVE_S:
        raise CommandLineInvalid(
            f"An interleave of {1e6 * interleave_s:.0f} microseconds is not possible.",
            hint=f"160 for time-of-flight sensors, 0 for others; at most {1e6 * LARGEST_INTERLEAVE_S:.0f}.",
        )
    late = interleave_s * np.arange(len(names))
    return replace(Clocks.alike(names), offset_s=-late, method="trigger")
