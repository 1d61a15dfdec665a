"""What the network is told of a cloud: waves of the coordinates, and how far points are from each other."""

from __future__ import annotations

import math

FREQUENCIES: tuple[float, ...] = tuple(math.pi * 2.0**k for k in range(5))
"""Angular frequencies of the coordinates' sines and cosines, 1/m: wavelengths from 2 m to 0.125 m."""
RADII_M: tuple[float, ...] = tuple(0.05 + 0.1 * k for k in range(12))
"""Distances whose bumps make the bias of an attention; beyond 1.25 m they all fade."""
RADIUS_WIDTH = 0.1
"""Width of a bump, metres."""
