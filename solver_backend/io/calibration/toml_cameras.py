"""Calibrations in TOML: Pose2Sim, anipose, FreeMoCap, caliscope."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from solver_backend.io.calibration.camera_fields import camera_entry, is_camera
from solver_backend.io.calibration.entry import CameraEntry
from solver_backend.io.files import read_toml


def camera_tables(tables: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield name and table of each camera: ``[cam_01]``, or ``[cameras.0]`` as ``cam_0``; ignored ones are left out."""
    for key, table in tables.items():
        if not isinstance(table, Mapping) or table.get("ignore") is True:
            continue
        if is_camera(table):
            yield (f"cam_{key}" if key.isdigit() else key), table
        elif key == "cameras":
            yield from camera_tables(table)


def read_toml_cameras(path: Path) -> list[CameraEntry]:
    """Return the cameras of a TOML calibration, in the file's unit.

    Each has a table with ``matrix`` (3, 3), ``distortions``, ``rotation`` (a Rodrigues vector or a matrix, world to
    camera) and ``translation``; ``size`` and ``fisheye`` may be missing.

    Raises:
        FileMissing, FileDamaged: the file is not there or is not TOML.
        CalibrationInvalid: a camera lacks a value or has one of a wrong size.
    """
    return [camera_entry(name, table, where=str(path)) for name, table in camera_tables(read_toml(path))]
