"""What sensors saw of a wand: pixels and depths on each one's own clock, and all of them at the same moments."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.plausible import FARTHEST_M, FARTHEST_PX, LONGEST_S
from solver_backend.sensors.wand.errors import TimesInvalid
from solver_backend.types.shapes import Bool, Float

LARGEST_LEFT_OUT = 0.2
"""Share of a recording's rows whose times go back with which it is not used."""


@dataclass(frozen=True)
class WandView:
    """One sensor's recording of a wand of K lights."""

    name: str
    """The sensor's name."""
    lens: Lens
    """Its lens."""
    times_s: Float[np.ndarray, " frames"]
    """(F,) on its own clock, growing."""
    px: Float[np.ndarray, "frames lights 2"]
    """(F, K, 2) pixels, NaN where a light is not seen; nothing at all where anything else shone too."""
    depth_m: Float[np.ndarray, "frames lights"] | None = None
    """(F, K) metres along the optical axis, NaN where there is none; None of a sensor without depth."""
    crowded: int = 0
    """Frames in which more than one wand, or anything else, shone."""
    findings: tuple[Diagnostic, ...] = ()
    """What was wrong with the recording."""

    def __post_init__(self) -> None:
        """Take what lies beyond any picture and any sensor's reach as not seen."""
        object.__setattr__(self, "px", np.where(np.abs(self.px) <= FARTHEST_PX, self.px, np.nan))
        if self.depth_m is not None:
            within = (self.depth_m > 0) & (self.depth_m <= FARTHEST_M)
            object.__setattr__(self, "depth_m", np.where(within, self.depth_m, np.nan))

    def __len__(self) -> int:
        return len(self.times_s)


@dataclass(frozen=True)
class Moments:
    """C views at M common moments."""

    times_s: Float[np.ndarray, " moments"]
    """(M,) on the first view's clock."""
    px: Float[np.ndarray, "views moments lights 2"]
    """(C, M, K, 2) pixels, NaN where not seen."""
    velocity: Float[np.ndarray, "views moments lights 2"]
    """(C, M, K, 2) px/s, NaN where not known."""
    depth_m: Float[np.ndarray, "views moments lights"]
    """(C, M, K) metres, NaN where there is none."""

    @property
    def seen(self) -> Bool[np.ndarray, "views moments"]:
        """(C, M) whether the whole wand is seen."""
        return np.isfinite(self.px).all((-1, -2))

    def where(self, chosen: np.ndarray) -> Moments:
        """Return chosen moments, by a mask or by their numbers."""
        return Moments(self.times_s[chosen], self.px[:, chosen], self.velocity[:, chosen], self.depth_m[:, chosen])


def with_growing_times(view: WandView) -> WandView:
    """Return the view without the rows whose times do not grow; each time belongs to one row.

    Raises:
        TimesInvalid: that are too many, or none is left, or the rows span more than a day.
    """
    times = view.times_s
    before = np.r_[-np.inf, np.maximum.accumulate(np.where(np.isfinite(times), times, -np.inf))[:-1]]
    good = np.isfinite(times) & (times > before)
    lost = int((~good).sum())
    if not good.any() or lost > LARGEST_LEFT_OUT * len(times):
        first = float(times[int(np.argmin(good))]) if len(times) else float("nan")
        raise TimesInvalid(
            f"{lost} of {len(times)} rows go backwards in time, the first at {first:.3f} s.",
            where=f"sensor {view.name}",
            hint="If the sensor was started again, put each recording into its own file.",
        )  # fmt: skip
    first, last = times[good][[0, -1]].tolist()
    if not last - first <= LONGEST_S:
        raise TimesInvalid(
            f"The rows span {last - first:.3g} s.", where=f"sensor {view.name}", hint="Times are in nanoseconds."
        )
    if not lost:
        return view
    after = float(before[int(np.argmin(good))])
    back = diagnostic("wand_times_back", cameras=[view.name], lost=lost, after=after)
    return replace(
        view, times_s=times[good], px=view.px[good], depth_m=None if view.depth_m is None else view.depth_m[good],
        findings=(*view.findings, back),
    )  # fmt: skip
