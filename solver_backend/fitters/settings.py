"""Settings of a solve; every field can be set from a job file."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from solver_backend.exchange.errors import JobInvalid

METHODS = ("global", "sliding", "frame", "noise-aware")
"""Names of the methods; ``methods.METHODS`` has what each is, and imports every solver."""
BACKENDS = ("numpy", "torch", "cuda")


@dataclass(frozen=True)
class SolveSettings:
    """What to solve with."""

    method: str = "global"
    """'global': all latent keyframes of the take at once; 'sliding': window after window on the prior's manifold, as
    published (thesis 6.3.2); 'frame': every frame on its own (eq. 6.5); 'noise-aware': the same with a variance for
    each landmark, estimated with the pose, as published (eq. 5.8)."""
    backend: str = "numpy"
    """'numpy' works everywhere; 'torch' uses torch's threads, 'cuda' torch on a graphics processor (results agree to
    0.1 mm)."""
    window: int = 20
    """Frames a window of 'sliding'; it holds a key at each end and one in the middle."""
    iterations: int = 30
    """Linearisations at most for each step of the robust schedule; most end sooner, when the cost no longer falls."""
    robust_scale: float = 4.0
    """Geman-McClure scale in standard deviations of the detector's noise."""
    refine_window: int = 10
    """The same for 'global', as a duration: so many frames at 60 a second, and down to 0.6 times as many in takes that
    are fast throughout, 0.4 where they are of markers."""
    residual_rotations: bool = True
    """In the refinement, let each joint leave the prior's manifold by a small rotation."""
    body: str = "neutral"
    """Name of the body, or the path of a body file."""
    layout: str = ""
    """Path of a file that says which place each marker's label names; empty goes by the layouts that are known."""
    noise: str = ""
    """Path of a file that says how far the detector's keypoints scatter at each confidence; empty takes confidences as
    they are."""
    estimate_sync: bool = False
    """Where some camera is late, move the others by their delays too; without, only by sure ones from 0.3 frames on."""
    contacts: bool = True
    """Hold feet that stand to where they stand."""
    smoothing: float = 1.0
    """How many times as bounded accelerations are as those of recorded motion: 1 follows the data, 4 is calm."""
    foot_lock: float = 1.0
    """How many times as firmly standing feet are held; beyond 5 the equations grow too stiff, and feet slip again."""
    learn_noise: bool = True
    """Learn how reliable each keypoint is in each view; without it all views of a keypoint count alike."""
    leave_out: tuple[str, ...] = ()
    """Views that take no part: CAMERA, or CAMERA:FIRST-LAST in frames from 0."""
    betas: tuple[float, ...] | None = None
    """Known shape; None estimates it from the take."""

    def __post_init__(self) -> None:
        checks = {
            "method": (self.method in METHODS, f"one of {', '.join(METHODS)}"),
            "backend": (self.backend in BACKENDS, f"one of {', '.join(BACKENDS)}"),
            "window": (isinstance(self.window, int) and 4 <= self.window <= 240, "a whole number from 4 to 240"),
            "refine_window": (
                isinstance(self.refine_window, int) and 2 <= self.refine_window <= 240,
                "a whole number from 2 to 240",
            ),
            "iterations": (
                isinstance(self.iterations, int) and 1 <= self.iterations <= 200,
                "a whole number from 1 to 200",
            ),
            "residual_rotations": (isinstance(self.residual_rotations, bool), "true or false"),
            "estimate_sync": (isinstance(self.estimate_sync, bool), "true or false"),
            "contacts": (isinstance(self.contacts, bool), "true or false"),
            "learn_noise": (isinstance(self.learn_noise, bool), "true or false"),
            "robust_scale": (0.1 <= self.robust_scale <= 100, "a number from 0.1 to 100"),
            "smoothing": (0.1 <= self.smoothing <= 100, "a number from 0.1 to 100"),
            "foot_lock": (0.1 <= self.foot_lock <= 5, "a number from 0.1 to 5"),
            "layout": (isinstance(self.layout, str), "the path of a layout's file"),
            "noise": (isinstance(self.noise, str), "the path of a detector's noise map"),
            "body": (isinstance(self.body, str) and bool(self.body.strip()), "a body's name or the path of its file"),
            "leave_out": (
                all(isinstance(item, str) for item in self.leave_out),
                "a list of CAMERA or CAMERA:FIRST-LAST",
            ),
            "betas": (self.betas is None or len(self.betas) == 10, "10 numbers or null"),
        }
        for name, (valid, expected) in checks.items():
            if not valid:
                raise JobInvalid(
                    f"The setting {name} = {getattr(self, name)!r} is not valid; {expected} is expected.", where=name
                )

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> SolveSettings:
        """Build settings from plain values.

        Raises:
            JobInvalid: a key is unknown or a value impossible.
        """
        known = [f.name for f in fields(cls)]
        unknown = sorted(set(values) - set(known))
        if unknown:
            raise JobInvalid(f"Unknown setting {', '.join(unknown)}.", hint=f"Known settings: {', '.join(known)}.")
        lists = {name: tuple(values[name]) for name in ("betas", "leave_out") if values.get(name) is not None}
        return cls(**{**values, **lists})
