"""``perturb`` of a description: presets and keys of the faults that are laid over the truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from solver_backend.synthesis.faults import (
    MEASURED_DETECTOR,
    OPTICAL_MARKERS,
    CameraFaults,
    DetectorFaults,
    Faults,
    MarkerFaults,
)
from solver_backend.synthesis.studio.checked_values import CheckedValues

_KEYS: dict[str, tuple[str, ...]] = {
    "bias_mm": ("detector", "view_bias_mm"), "drift_mm": ("detector", "drift_mm"),
    "jitter_mm": ("detector", "jitter_mm"), "missing": ("detector", "missing"),
    "occluded_missing": ("detector", "occluded_missing"), "outliers": ("detector", "outliers"),
    "swaps_per_minute": ("detector", "swaps_per_minute"), "anatomy_mm": ("anatomy_mm",),
    "calibration_mm": ("cameras", "calibration_mm"), "delay_frames": ("cameras", "delay_frames"),
    "marker_mm": ("markers", "measurement_mm"), "placement_mm": ("markers", "placement_mm"),
    "skin_mm": ("markers", "skin_mm"), "marker_gaps": ("markers", "hidden"), "marker_views": ("markers", "least_views"),
    "marker_swaps_per_minute": ("markers", "swaps_per_minute"), "ghosts": ("markers", "ghosts"),
}  # fmt: skip
"""Where a description's keys stand in ``Faults``; 0 leaves a fault out."""
_LARGEST = {"missing": 0.9, "occluded_missing": 0.95, "outliers": 0.9, "marker_gaps": 0.9, "ghosts": 0.9}
PRESETS: dict[str, Faults] = {
    "none": Faults(),
    "jitter": Faults(DetectorFaults(jitter_mm=5.0)),
    "detector": Faults(MEASURED_DETECTOR, 8.0, CameraFaults(8.0)),
    "good_detector": Faults(
        DetectorFaults(
            view_bias_mm=4.0, drift_mm=6.0, jitter_mm=3.0, missing=0.002, occluded_missing=0.3, outliers=0.002
        ),
        5.0,
        CameraFaults(2.0),
    ),
    "optical_markers": Faults(markers=replace(OPTICAL_MARKERS, swaps_per_minute=1.0, ghosts=0.001)),
    "depth_markers": Faults(
        markers=MarkerFaults(measurement_mm=4.0, placement_mm=8.0, skin_mm=1.5, hidden=0.15, ghosts=0.01)
    ),
}
"""'detector' is the measured one, 'optical_markers' the demo take's; the others are chosen."""


def read_faults(description: Any) -> Faults:
    """Return faults from the name of a preset or an object, which may name a preset to start from.

    Raises:
        StudioInvalid: a key or preset is unknown, or a value is impossible.
    """
    given = {"preset": description} if isinstance(description, str) else description
    values = CheckedValues(given, "perturb", ("preset", *_KEYS))
    faults = PRESETS[values.choice("preset", "none", PRESETS)]
    for key, known in sizes_of(faults).items():
        part, *rest = _KEYS[key]
        value: Any = values.number(key, known, 0.0, _LARGEST.get(key, 1000.0))
        faults = replace(faults, **{part: replace(getattr(faults, part), **{rest[0]: value}) if rest else value})
    return faults


def sizes_of(faults: Faults) -> dict[str, float]:
    """Return the sizes of faults by the keys of a description."""
    parts = {"": faults, "detector": faults.detector, "cameras": faults.cameras, "markers": faults.markers}
    return {key: getattr(parts["".join(path[:-1])], path[-1]) for key, path in _KEYS.items()}
