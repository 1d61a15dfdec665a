"""Every kind of capture and of motion that is read; a new one is a module and a row here."""

from __future__ import annotations

from solver_backend.io import own_files
from solver_backend.io.captures import caliscope, detection_folders
from solver_backend.io.captures.optical_markers import marker_readers
from solver_backend.io.motions import amass, bvh
from solver_backend.io.motions.amass import AmassClip
from solver_backend.io.motions.bvh import BvhClip
from solver_backend.io.reader import Reader
from solver_backend.types import Capture, Motion

CAPTURES: tuple[Reader[Capture], ...] = (
    own_files.CAPTURE,
    detection_folders.READER,
    caliscope.READER,
    *marker_readers(),
)
"""Asked in this order; the first that recognises a path reads it."""

MOTIONS: tuple[Reader[Motion] | Reader[AmassClip] | Reader[BvhClip], ...] = (
    bvh.READER,
    amass.READER,
    own_files.MOTION,
)
"""Asked in this order; a clip of another skeleton or body becomes a motion by what knows that body."""
