"""Blender's axes (Z up) to those of formats with Y up, as glTF, FBX and OpenSim have it."""

from __future__ import annotations

import numpy as np

R_YUP_ZUP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""(x, y, z) becomes (x, z, -y): what faces Blender's front, -Y, faces +Z."""
