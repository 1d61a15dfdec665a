"""The settings of a solve. Solver, job file, command line, panels and reference page derive from these rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .diagnostics import check_accepted
from .setting import Choice, check_settings, known_values, setting, settings_of_class

METHOD, CLEAN_UP, RECORDING, RESOURCES = "Method", "Clean-up", "Recording and result", "Body, files and arrays"
"""Groups. Those of the first are what a preset of the panel chooses."""
GLOBAL, SLIDING = "global", "sliding"
METHODS = (
    Choice(GLOBAL, "Whole Take", "All keyframes of the take at once"),
    Choice(SLIDING, "Sliding Window", "Window after window, as published: for very long takes and for comparison"),
    Choice("frame", "Frame by Frame", "Every frame on its own: for single poses and for comparison"),
    Choice("noise-aware", "Noise-Aware", "Every frame on its own, each landmark's reliability estimated, as published"),
)
"""'sliding' is of the thesis, 6.3.2, 'frame' eq. 6.5, 'noise-aware' eq. 5.8 (Albanis 2026)."""
LANDMARKS_LABELLED, LANDMARKS_NETWORK, LANDMARKS_JOINTS = "labelled", "network", "network-joints"
LANDMARKS = (
    Choice(LANDMARKS_LABELLED, "Labelled", "The markers themselves, which get labels first where they lack them"),
    Choice(LANDMARKS_NETWORK, "Network", "The labelling network's 53 markers of every frame; no label is used"),
    Choice(LANDMARKS_JOINTS, "With Joints", "The same with the network's 24 joints"),
)
"""The thesis fits estimated landmarks directly (5.2.2)."""
APART, SCREW = "apart", "screw"
ROOT_CURVES = (
    Choice(APART, "Apart", "Rotation and translation each on a curve of its own, as published"),
    Choice(SCREW, "Screw", "Both together on screws of SE(3): where the body turns, it travels on an arc"),
)
"""Thesis 6.2.5 (eq. 6.10), and 6.4 for the screw."""
METHOD_NAMES = tuple(method.value for method in METHODS)
BACKENDS = (
    Choice("numpy", "NumPy", "Works everywhere"),
    Choice("torch", "PyTorch", "Needs a Python with torch, chosen in the add-on's preferences"),
    Choice("cuda", "CUDA", "Needs a Python with torch for CUDA and an NVIDIA graphics processor"),
)
"""Their results agree to 0.1 mm."""
SYNC_AUTO, SYNC_ON, SYNC_OFF = "auto", "on", "off"
SYNCS = (
    Choice(SYNC_AUTO, "Where Sure", "Move cameras in time where the views agree clearly better then"),
    Choice(SYNC_ON, "Required", "The same, and refuse a capture whose synchronisation the views do not confirm"),
    Choice(SYNC_OFF, "As Recorded", "Move no camera in time"),
)


@dataclass(frozen=True)
class SolveSettings:
    """Settings of a solve."""

    # fmt: off
    method: str = setting(
        "choice", GLOBAL, "Method", "How frames are tied together", group=METHOD, choices=METHODS, metavar="NAME")
    window: int = setting(
        "whole", 20, "Window", "Frames at 60 a second between the ends of a window of keyframes", group=METHOD,
        low=4, high=240, unit="frames", methods=(SLIDING,))
    """Frames a window of 'sliding'. It holds a key at each end and ``interpolation`` - 1 between."""
    refine_window: int = setting(
        "whole", 10, "Refined Window", "The same for the last passes; fewer follow faster limbs", group=METHOD,
        low=2, high=240, unit="frames", methods=(GLOBAL,))
    """The same for 'global', as a duration: so many frames at 60 a second, and down to 0.6 times as many in takes that
    are fast throughout, 0.4 where they are of markers."""
    interpolation: int = setting(
        "whole", 2, "Keys a Window", "Free keyframes of a sliding window, n of SIDER-n: 1 is SLERP, 2 as published",
        group=METHOD, low=1, high=6, methods=(SLIDING,))
    """Of 'sliding' alone (thesis 6.4). Beyond 6 a polynomial of translations swings between its keys."""
    root_curve: str = setting(
        "choice", APART, "Root Curve", "How the root moves between the keyframes of a sliding window", group=METHOD,
        choices=ROOT_CURVES, metavar="NAME", methods=(SLIDING,))
    """Of 'sliding' alone."""
    residual_rotations: bool = setting(
        "switch", True, "Free Joints", "Let joints leave the manifold of learned poses a little", group=METHOD,
        methods=(GLOBAL,))
    """In the refinement, let each joint leave the prior's manifold by a small rotation."""
    contacts: bool = setting(
        "switch", True, "Foot Contact", "Hold feet that stand to where they stand", group=METHOD, methods=(GLOBAL,))
    learn_noise: bool = setting(
        "switch", True, "Camera Weighting", "Learn how reliable each keypoint is in each view", group=METHOD,
        methods=(GLOBAL,))
    """Without it all views of a keypoint count alike."""
    iterations: int = setting(
        "whole", 30, "Iterations", "Linearisations at most for each robust step", group=METHOD, low=1, high=200)
    """Most steps end sooner, when the cost no longer falls."""
    robust_scale: float = setting(
        "number", 4.0, "Outlier Scale", "Standard deviations at which a detection starts to be doubted", group=METHOD,
        low=0.1, high=100, unit="standard deviations")
    """Geman-McClure scale in standard deviations of the detector's noise."""
    smoothing: float = setting(
        "number", 1.0, "Smoothing",
        "How many times as smooth as recorded motion: 1 follows the detections, 3 is smooth, 10 loses detail",
        group=CLEAN_UP, low=0.1, high=100, soft_high=10, methods=(GLOBAL,))
    """How many times as bounded accelerations are as those of recorded motion."""
    foot_lock: float = setting(
        "number", 1.0, "Foot Lock", "How many times as firmly standing feet are held where they stand", group=CLEAN_UP,
        low=0.1, high=5, methods=(GLOBAL,))
    """Beyond 5 the equations grow too stiff, and feet slip again."""
    sync: str = setting(
        "choice", SYNC_AUTO, "Synchronise", "Whether cameras that started apart are moved in time", group=RECORDING,
        choices=SYNCS, metavar="NAME")
    estimate_sync: bool = setting(
        "switch", False, "Correct Delays", "Where some camera is late, move the others by their delays too; "
        "without, only sure delays from 0.3 frames on are corrected", group=RECORDING)
    leave_out: tuple[str, ...] = setting(
        "texts", (), "Left-out Views", "Camera that takes no part, in some frames (from 0) or in all",
        group=RECORDING, metavar="CAMERA[:FIRST-LAST]", in_panel=False)
    accept: tuple[str, ...] = setting(
        "texts", (), "Accepted Faults", "Code of a fault for which a result would be refused, which is taken as a "
        "warning instead", group=RECORDING, metavar="CODE")
    """Codes of errors in the table of diagnostics."""
    body: str = setting(
        "name_or_file", "neutral", "Body", "Name of a body, or the path of a body file; empty for the one that ships",
        group=RESOURCES, metavar="NAME|PATH")
    betas: tuple[float, ...] | None = setting(
        "numbers", None, "Shape", "Known shape of the body; estimated from the take where it is left out",
        group=RESOURCES, count=10, metavar="B0,B1,…", in_panel=False)
    noise: str = setting(
        "file", "", "Detector's Noise", "File with the scatter of the detector's keypoints at each confidence, "
        "as the command line's detector-noise measures it; empty takes confidences as they are",
        group=RESOURCES, metavar="NOISE.json")
    landmarks: str = setting(
        "choice", LANDMARKS_LABELLED, "Landmarks", "What 'noise-aware' fits of a recording of markers",
        group=RECORDING, choices=LANDMARKS, metavar="NAME")
    """Direct solving of what a network has for each frame, beside labels first."""
    layout: str = setting(
        "file", "", "Marker Layout", "File with the place that each marker's label names, as the command line's "
        "layout writes it; empty uses the known layouts", group=RESOURCES, metavar="LAYOUT.json",
        in_panel=False)
    backend: str = setting(
        "choice", "numpy", "Compute", "Library that computes", group=RESOURCES, choices=BACKENDS, metavar="NAME")
    # fmt: on

    def __post_init__(self) -> None:
        check_settings(self)
        check_accepted(self.accept)

    @property
    def other_curves(self) -> tuple[str, ...]:
        """Names of the settings of curves between keyframes that differ from the publication."""
        published = (("interpolation", 2), ("root_curve", APART))
        return tuple(name for name, value in published if getattr(self, name) != value)

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Names of the settings that differ from their default and have no effect in the method."""
        rows = {name: row for name, row in settings_of_class(SolveSettings).items() if not row.acts_in(self.method)}
        return tuple(name for name, row in rows.items() if getattr(self, name) != row.default)

    @property
    def is_direct(self) -> bool:
        """Whether a network's landmarks are fitted instead of labelled markers."""
        return self.landmarks != LANDMARKS_LABELLED

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> SolveSettings:
        """Build settings from plain values. None is the default."""
        return cls(**known_values(cls, values))
