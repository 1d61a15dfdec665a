"""What the network is given of a cloud: waves of the coordinates, and how far points are from each other."""

from __future__ import annotations

import math

FREQUENCIES: tuple[float, ...] = tuple(math.pi * 2.0**k for k in range(5))
"""Angular frequencies of the coordinates' sines and cosines, 1/m: wavelengths from 2 m to 0.125 m."""
NEARNESS: tuple[float, ...] = tuple(0.2 + 0.13 * k for k in range(8))
"""Roots of the distances whose bumps make the bias of an attention: 4 cm to 1.2 m, denser where markers are near."""
NEARNESS_WIDTH = 0.13
"""Width of a bump, in roots of metres."""
