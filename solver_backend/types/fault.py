"""What was found wrong with a recording, and what was done about it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any


class FaultKind(StrEnum):
    """What can be wrong with a recording; the value is the name written to files."""

    LIMBS_EXCHANGED = "limbs_exchanged"
    """The detector took left for right limbs for a while. The figure is the gain in cost."""
    SIDES_EXCHANGED = "sides_exchanged"
    """All left and right keypoints of a view are exchanged. No figure."""
    IMAGE_MIRRORED = "image_mirrored"
    """The image is mirrored, or its x runs from right to left. No figure."""
    NAMES_EXCHANGED = "names_exchanged"
    """The view has the detections (or the calibration) of another, which the detail names. No figure."""
    CAMERA_TURNED = "camera_turned"
    """The camera was turned after its calibration. The figure is in degrees."""
    UNSYNCHRONISED = "unsynchronised"
    """The camera runs late. The figure is in frames, negative where it runs early."""
    RATE_DIFFERS = "rate_differs"
    """The camera runs at another rate. The figure is how many frames later it is at the end than at the beginning."""
    FRAMES_REPEATED = "frames_repeated"
    """The view shows the frame before once more. The figure is the share of such frames in the view, per cent."""
    FRAMES_SKIPPED = "frames_skipped"
    """No view shows anybody in frames between frames that do. The figure is their share, per cent; no camera."""
    DELAY_UNKNOWN = "delay_unknown"
    """Too little moves in the view (in all views, if no camera is named) to tell whether it is in step. No figure."""
    CONTRADICTS = "contradicts"
    """The view shows something else than the others do, such as another person. No figure."""
    PERSON_AWAY = "person_away"
    """No two cameras see the person; there is no camera to name. No figure."""

    MARKERS_EXCHANGED = "markers_exchanged"
    """Two markers have each other's labels. No figure and no camera; the detail names them."""
    MARKER_GHOST = "marker_ghost"
    """A point is where its marker cannot be. No figure and no camera; the detail names the marker."""
    MARKER_STILL = "marker_still"
    """A marker stands still while the person moves. No figure and no camera; the detail names it."""


class Remedy(StrEnum):
    """What was done about a fault."""

    REPAIRED = "repaired"
    """The detections or the camera were repaired."""
    EXCLUDED = "excluded"
    """The view's detections were not used in these frames."""
    BRIDGED = "bridged"
    """The motion was interpolated."""
    REPORTED = "reported"
    """Nothing was changed."""


@dataclass(frozen=True)
class Fault:
    """One fault of one view over a range of frames."""

    kind: FaultKind
    """What is wrong."""
    camera: str
    """Name of the camera, empty where it is all."""
    first: int
    """First frame."""
    last: int
    """Last frame."""
    figure: float
    """Its size; the unit goes with the kind."""
    remedy: Remedy
    """What was done."""
    detail: str = ""
    """Which part of the view, where that matters."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {**asdict(self), "kind": self.kind.value, "remedy": self.remedy.value}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Fault:
        """Return a fault from plain values, as ``as_dict`` gives them."""
        return cls(**{**values, "kind": FaultKind(values["kind"]), "remedy": Remedy(values["remedy"])})
