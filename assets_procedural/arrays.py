"""The arrays of the generator: NumPy's alone."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


NONE, LIPS, EYEBALL, IRIS, PUPIL, NAIL = range(6)
