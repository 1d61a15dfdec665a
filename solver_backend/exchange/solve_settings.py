"""Declare the solve settings for the solver, jobs, command line, panels and pages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from .setting import Choice, check_settings, known_values, setting, settings_of_class

METHOD, CLEAN_UP, RECORDING, RESOURCES = "Method", "Clean-up", "Recording and result", "Body, files and arrays"
"""Groups of settings. A panel preset changes the settings in the first group."""
GLOBAL, SLIDING, BUNDLEMOCAP, NOISE_AWARE = "global", "sliding", "bundlemocap++", "noise-aware"
METHODS = (
    Choice(GLOBAL, "Whole Take", "Solve all keyframes of the take at once (recommended)"),
    Choice(
        BUNDLEMOCAP,
        "BundleMoCap++",
        "Solve windows using only the detections, as in Albanis 2026 (thesis 6.2.5)",
    ),
    Choice(SLIDING, "Sliding Windows", "Solve windows with a pose mixture and Gauss-Newton steps, for very long takes"),
    Choice("frame", "Frame by Frame", "Solve each frame separately, for single poses"),
    Choice(
        NOISE_AWARE,
        "Noise-Aware",
        "Estimate each landmark's noise in each frame, for network landmarks (Albanis 2026, chapter 5)",
    ),
)
"""Sources: thesis (Albanis 2026), 6.2.5 for 'bundlemocap++', eq. 6.5 for 'frame', eq. 5.8 for 'noise-aware'."""
AUTO_PRIOR = "auto"
PRIORS = (
    Choice(AUTO_PRIOR, "Method Default", "Use SPoser, or RVPoser for the noise-aware method (recommended)"),
    Choice("sposer", "SPoser", "Codes on a sphere (Albanis 2026, thesis 6.2.2), for most methods"),
    Choice("rvposer", "RVPoser", "Robust Gaussian codes (Albanis 2026, thesis 4.2.4), for noise-aware"),
    Choice("vposer", "VPoser", "Gaussian codes (Pavlakos et al. 2019), for comparison"),
)
LANDMARKS_LABELLED, LANDMARKS_NETWORK, LANDMARKS_JOINTS = "labelled", "network", "network-joints"
LANDMARKS = (
    Choice(LANDMARKS_LABELLED, "Labelled", "The recorded markers, labelled first if they have no labels (recommended)"),
    Choice(
        LANDMARKS_NETWORK,
        "Network",
        "The 53 markers of the labelling network, as in Albanis 2026 (thesis 5.2.2)",
    ),
    Choice(
        LANDMARKS_JOINTS,
        "With Joints",
        "The network's 53 markers and 24 joints",
    ),
)
"""The thesis fits estimated landmarks directly (5.2.2)."""
APART, SCREW = "apart", "screw"
ROOT_CURVES = (
    Choice(APART, "Apart", "Interpolate rotation and translation separately, as in Albanis 2026 (recommended)"),
    Choice(SCREW, "Screw", "Interpolate both as screw motions in SE(3), for turns on an arc"),
)
"""Curves of the root. Source: thesis 6.2.5 (eq. 6.10), and 6.4 for the screw."""
METHOD_NAMES = tuple(method.value for method in METHODS)
BACKENDS = (
    Choice("numpy", "NumPy", "Works everywhere (recommended)"),
    Choice("torch", "PyTorch", "Needs a Python with torch, and is not faster than NumPy in our tests"),
    Choice("cuda", "CUDA", "Needs an NVIDIA GPU and a Python with torch for CUDA"),
)
"""The results of the two backends agree within 0.1 mm."""
SYNC_AUTO, SYNC_ON, SYNC_OFF = "auto", "on", "off"
SYNCS = (
    Choice(SYNC_AUTO, "If Certain", "Shift cameras in time if the views clearly agree better afterwards (recommended)"),
    Choice(
        SYNC_ON,
        "Required",
        "Like auto, but reject captures that remain uncertain, for unsynchronised cameras",
    ),
    Choice(SYNC_OFF, "As Recorded", "Do not shift cameras in time, for cameras that started together"),
)
_method, _clean_up, _recording, _resource = (
    partial(setting, group=group) for group in (METHOD, CLEAN_UP, RECORDING, RESOURCES)
)


@dataclass(frozen=True)
class SolveSettings:
    """Settings of a solve.

    Raises:
        JobInvalid: a value has another type or is out of range.
    """

    # fmt: off
    method: str = _method("choice", GLOBAL, "Method", "Frames that are solved together", choices=METHODS,
        metavar="NAME")
    window: int = _method(
        "whole", 20, "Window", "Length of the keyframe windows, in frames at 60 Hz", low=4, high=240,
        unit="frames", methods=(SLIDING, BUNDLEMOCAP), rare=True)
    """Frames per window in both sliding methods, with a key at each end and ``interpolation`` - 1 keys between them."""
    refine_window: int = _method(
        "whole", 10, "Refined Window", "Window length in the last passes, shortened automatically in fast takes",
        low=2, high=240, unit="frames", methods=(GLOBAL,), rare=True)
    """The same for 'global', given as a duration in frames at 60 Hz. Fast takes use shorter windows, which are at least
    0.6 times as long with views and 0.4 times with markers."""
    interpolation: int = _method(
        "whole", 2, "Keys per Window", "Free keyframes per window: 1 gives SLERP, 2 the curve from Albanis 2026",
        low=1, high=6, methods=(SLIDING,), rare=True)
    """Used only by 'sliding' (thesis 6.4). Above 6, a polynomial for translations oscillates between its keys."""
    root_curve: str = _method(
        "choice", APART, "Root Curve", "Interpolation of the body's path and heading between keyframes",
        choices=ROOT_CURVES, metavar="NAME", methods=(SLIDING,), rare=True)
    """Used only by 'sliding'."""
    residual_rotations: bool = _method(
        "switch", True, "Free Joints", "Let each joint deviate from the pose prior by a small rotation",
        methods=(GLOBAL,), rare=True)
    """Each joint may leave the prior's manifold by a small rotation during refinement."""
    contacts: bool = _method(
        "switch", True, "Foot Contact", "Keep feet and other parts still while they touch the floor", methods=(GLOBAL,)
    )
    learn_noise: bool = _method(
        "switch", True, "Camera Weighting", "Estimate the reliability of each keypoint in each view",
        methods=(GLOBAL,), rare=True)
    """If it is off, all views of a keypoint have the same weight."""
    temporal: bool = _method(
        "switch", False, "Temporal Term", "Limit landmark accelerations, unlike Albanis 2026",
        methods=(NOISE_AWARE,), rare=True)
    """Solves the frames of a block together (thesis 5.4 names the absence of this term as a limitation)."""
    iterations: int = _method(
        "whole", 30, "Iterations", "Maximum number of solver steps at each robust scale", low=1, high=200, rare=True)
    """Most steps end earlier, when the cost stops decreasing."""
    robust_scale: float = _method(
        "number", 4.0, "Outlier Scale", "Error above which a detection loses weight", low=0.1, high=100,
        unit="standard deviations", rare=True)
    """Geman-McClure scale, in standard deviations of the detector noise."""
    smoothing: float = _clean_up(
        "number", 1.0, "Smoothing", "Strength: 1 follows the detections, 3 gives smooth motion, and 10 loses detail",
        low=0.1, high=100, soft_high=10, methods=(GLOBAL,))
    """Factor applied to the acceleration bound, which was measured in recorded motion."""
    foot_lock: float = _clean_up(
        "number", 1.0, "Foot Lock", "Higher values reduce foot sliding", low=0.1, high=5,
        methods=(GLOBAL,))
    """Above 5, the equations become too stiff, and feet slip again."""
    sync: str = _recording(
        "choice", SYNC_AUTO, "Synchronise", "Correction of camera delays", choices=SYNCS, metavar="NAME")
    estimate_sync: bool = _recording(
        "switch", False, "Correct Delays",
        "Also correct delays below 0.3 frames", rare=True)
    leave_out: tuple[str, ...] = _recording(
        "texts", (), "Left-out Views", "Camera to ignore in all frames, or in a frame range counted from 0",
        metavar="CAMERA[:FIRST-LAST]", control="*Cameras*", rare=True)
    accept: tuple[str, ...] = _recording(
        "texts", (), "Accepted Faults", "Error code to treat as a warning, so that the result is kept: "
        "views_contradict, residual_large, markers_far, markers_of_nobody, stature_odd, motion_rate_odd or "
        "motion_place_impossible", metavar="CODE", rare=True)
    """Codes of errors in the diagnostics table."""
    body: str = _resource(
        "name_or_file", "neutral", "Body", "Body name, or path of a body file",
        metavar="NAME|PATH")
    betas: tuple[float, ...] | None = _resource(
        "numbers", None, "Shape", "Shape coefficients of a known body, which are otherwise estimated", count=10,
        metavar="B0,B1,…", control="*Keep Shape* and the body's sliders", rare=True)
    noise: str = _resource(
        "file", "", "Detector Noise", "Noise map from `cameras noise`, with the keypoint scatter at each confidence",
        metavar="NOISE.json", rare=True)
    objects: str = _resource(
        "file", "", "Objects", "File with planes, boxes and meshes that the body can touch but not enter, by "
        "default the floor for views and nothing for markers", metavar="OBJECTS.json", methods=(GLOBAL,), rare=True)
    landmarks: str = _recording(
        "choice", LANDMARKS_LABELLED, "Landmarks", "Marker points that the noise-aware method uses",
        choices=LANDMARKS, metavar="NAME", rare=True)
    """Solves a network's landmarks per frame directly, without labelling markers first."""
    network: str = _resource(
        "file", "", "Label Network", "Labelling network created by train model or train export, by default "
        "the included one", metavar="NETWORK.npz|.onnx", rare=True)
    """Labels points, and provides the landmarks for ``landmarks``."""
    layout: str = _resource(
        "file", "", "Marker Layout", "File from `markers layout` with the position of each label, by default the "
        "known layouts", metavar="LAYOUT.json", control="*Markers*", rare=True)
    prior: str = _resource(
        "name_or_file", AUTO_PRIOR, "Pose Prior", "Model of plausible poses: sposer, rvposer, vposer, or a file of "
        "trained weights", choices=PRIORS, metavar="NAME|PATH", rare=True)
    backend: str = _resource("choice", "numpy", "Compute", "Library for array computations",
        choices=BACKENDS, metavar="NAME", rare=True)
    # fmt: on

    def __post_init__(self) -> None:
        check_settings(self)
        if self.accept:
            from .diagnostics import check_accepted  # rarely needed, and slow to import

            check_accepted(self.accept)

    @property
    def other_curves(self) -> tuple[str, ...]:
        """Names of the settings that make the curves between keyframes differ from the published method."""
        published = (("interpolation", 2), ("root_curve", APART))
        return tuple(name for name, value in published if getattr(self, name) != value)

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Names of non-default settings that have no effect in the chosen method."""
        rows = {name: row for name, row in settings_of_class(SolveSettings).items() if not row.acts_in(self.method)}
        return tuple(name for name, row in rows.items() if getattr(self, name) != row.default)

    @property
    def is_direct(self) -> bool:
        """True if the solve uses a network's landmarks rather than labelled markers."""
        return self.landmarks != LANDMARKS_LABELLED

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> SolveSettings:
        """Build settings from plain values. None means the default."""
        return cls(**known_values(cls, values))


PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"refine_window": 20, "iterations": 2, "learn_noise": False},
    "balanced": {},
}
"""Changes to the defaults for each purpose. ``dev.py bench presets`` measures the time and error of each."""
