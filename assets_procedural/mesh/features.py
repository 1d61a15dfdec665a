"""What a face of the body shows where it is not plain skin or suit."""

from __future__ import annotations

NONE, LIPS, EYEBALL, IRIS, PUPIL, NAIL = range(6)
