"""Perturbation: which faults of detectors, trackers and rigs are laid over the truth, and how strong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from solver_backend.synthesis.studio.checked_values import CheckedValues


@dataclass(frozen=True)
class Perturbation:
    """Stages that can be switched; 0 or false leaves one out."""

    bias_mm: float = 0.0
    """Error of a keypoint that depends on where the person is seen from, mm at the person's distance."""
    drift_mm: float = 0.0
    """Error that comes and goes."""
    jitter_mm: float = 0.0
    """Error that is new in every frame."""
    missing: float = 0.0
    """Share of detections that are lost for no reason."""
    occluded_missing: float = 0.0
    """Share of runs out of sight in which the detector gives up."""
    outliers: float = 0.0
    """Share of detections that are elsewhere."""
    swaps_per_minute: float = 0.0
    """Exchanges of left and right a limb and view."""
    anatomy_mm: float = 0.0
    """What a detector means by a joint against what our body means."""
    calibration_mm: float = 0.0
    """How far the calibration misplaces the person in a view."""
    delay_frames: float = 0.0
    """Largest lateness of a camera."""
    marker_mm: float = 0.0
    """Measurement error of markers."""
    placement_mm: float = 0.0
    """How far markers sit from their places."""
    skin_mm: float = 0.0
    """Skin that slides under markers."""
    marker_gaps: float = 0.0
    """Share of marker samples that are lost in gaps."""
    marker_views: float = 0.0
    """Cameras that must see a marker; one that fewer see is lost."""
    marker_swaps_per_minute: float = 0.0
    """Exchanges of two markers' labels."""
    ghosts: float = 0.0
    """Share of samples of a marker that are a ghost near the body."""

    @property
    def views(self) -> bool:
        """Whether keypoints are touched."""
        return any(getattr(self, name) for name in _OF_VIEWS)

    @property
    def of_markers(self) -> bool:
        """Whether markers are touched."""
        return any(getattr(self, name) for name in _OF_MARKERS)


_OF_VIEWS = (
    "bias_mm", "drift_mm", "jitter_mm", "missing", "occluded_missing", "outliers", "swaps_per_minute", "anatomy_mm",
    "calibration_mm", "delay_frames",
)  # fmt: skip
_OF_MARKERS = (
    "marker_mm",
    "placement_mm",
    "skin_mm",
    "marker_gaps",
    "marker_views",
    "marker_swaps_per_minute",
    "ghosts",
)
_LARGEST = {"missing": 0.9, "occluded_missing": 0.95, "outliers": 0.9, "marker_gaps": 0.9, "ghosts": 0.9}
PRESETS: dict[str, dict[str, float]] = {
    "none": {},
    "jitter": {"jitter_mm": 5.0},
    "detector": {
        "bias_mm": 9.0, "drift_mm": 17.0, "jitter_mm": 5.0, "missing": 0.005, "occluded_missing": 0.5,
        "outliers": 0.01, "swaps_per_minute": 6.0, "anatomy_mm": 8.0, "calibration_mm": 8.0,
    },
    "good_detector": {
        "bias_mm": 4.0, "drift_mm": 6.0, "jitter_mm": 3.0, "missing": 0.002, "occluded_missing": 0.3,
        "outliers": 0.002, "anatomy_mm": 5.0, "calibration_mm": 2.0,
    },
    "optical_markers": {
        "marker_mm": 0.3, "placement_mm": 8.0, "skin_mm": 1.5, "marker_gaps": 0.03, "marker_swaps_per_minute": 1.0,
        "ghosts": 0.001,
    },
    "depth_markers": {"marker_mm": 4.0, "placement_mm": 8.0, "skin_mm": 1.5, "marker_gaps": 0.15, "ghosts": 0.01},
}  # fmt: skip
"""'detector' is the one measured on Pose2Sim's recording (see ``simulation/keypoint_detector.py``), 'optical_markers'
the demo take's; the others are chosen."""


def read_perturbation(description: Any) -> Perturbation:
    """Return a perturbation from the name of a preset or an object, which may name a preset to start from.

    Raises:
        StudioInvalid: a key or preset is unknown, or a value is impossible.
    """
    given = {"preset": description} if isinstance(description, str) else description
    values = CheckedValues(given, "perturb", ("preset", *Perturbation.__dataclass_fields__))
    preset = PRESETS[values.choice("preset", "none", PRESETS)]
    return Perturbation(
        **{
            name: values.number(name, preset.get(name, 0.0), 0.0, _LARGEST.get(name, 1000.0))
            for name in Perturbation.__dataclass_fields__
        }
    )
