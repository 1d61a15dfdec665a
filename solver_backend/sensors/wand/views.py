"""Find the wand's LEDs in the views of each sensor, on one clock, and measure the coverage of the pictures."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import MocapError
from solver_backend.exchange.plausible import FARTHEST_M, FARTHEST_PX, LONGEST_S
from solver_backend.types import Cameras
from solver_backend.types.shapes import Bool, Float, Int


class WandNotSeen(MocapError):
    """A sensor never saw the wand, or never at a moment at which another one did."""

    code = "wand_not_seen"


class WandAmbiguous(MocapError):
    """More than one wand, or something else that shines, stood before the sensors."""

    code = "wand_ambiguous"


class WandInvalid(MocapError):
    """The wand's lengths are not such that its lights can be distinguished, or are not those that were seen."""

    code = "wand_invalid"


class TimesInvalid(MocapError):
    """A recording's times do not grow."""

    code = "times_invalid"


LARGEST_LEFT_OUT = 0.2
"""Share of a recording's rows whose times go back with which it is not used."""


@dataclass(frozen=True)
class WandView:
    """One sensor's recording of a wand of K lights."""

    name: str
    lens: Lens
    times_s: Float[np.ndarray, " frames"]
    """(F,) on its own clock, growing."""
    px: Float[np.ndarray, "frames lights 2"]
    """(F, K, 2) pixels, NaN where a light is not seen. Nothing at all where anything else shone too."""
    depth_m: Float[np.ndarray, "frames lights"] | None = None
    """(F, K) metres along the optical axis, NaN where there is none. None of a sensor without depth."""
    crowded: int = 0
    """Frames where more than one wand, or anything else, shone."""
    findings: tuple[Diagnostic, ...] = ()

    def __post_init__(self) -> None:
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
    """Return the view without the rows whose times do not grow. Each time belongs to one row.

    Raises:
        TimesInvalid: that are too many, or none is left, or the rows span more than a day.
    """
    times = view.times_s
    before = np.r_[-np.inf, np.maximum.accumulate(np.where(np.isfinite(times), times, -np.inf))[:-1]]
    good = np.isfinite(times) & (times > before)
    lost = int((~good).sum())
    if not good.any() or lost > LARGEST_LEFT_OUT * len(times):
        first = float(times[int(np.argmin(good))]) if len(times) else float("nan")
        message = f"{lost} of {len(times)} rows go backwards in time, the first at {first:.3f} s."
        hint = "If the sensor was started again, put each recording into its own file."
        raise TimesInvalid(message, where=f"sensor {view.name}", hint=hint)
    first, last = times[good][[0, -1]].tolist()
    if not last - first <= LONGEST_S:
        raise TimesInvalid(
            f"The rows span {last - first:.3g} s.", where=f"sensor {view.name}", hint="Times are in nanoseconds."
        )
    if not lost:
        return view
    after = float(before[int(np.argmin(good))])
    back = diagnostic("wand_rows_ignored", reason="back", cameras=[view.name], lost=lost, after=after)
    return replace(
        view,
        times_s=times[good],
        px=view.px[good],
        depth_m=None if view.depth_m is None else view.depth_m[good],
        findings=(*view.findings, back),
    )


SURE_SHARE = 0.43
"""Largest visible share of the shorter part with which the ends are distinguished."""
STRAIGHT = 0.03
"""The middle light may be off the line of the others by this share of the wand, as it is seen, ..."""
STRAIGHT_SIGMAS = 4.0
"""... or by this many standard deviations of a pixel position."""
SHORTEST_M, LONGEST_M = 0.02, 5.0


@dataclass(frozen=True)
class Wand:
    """Distances between neighbouring lights, metres."""

    first_m: float
    second_m: float

    def __post_init__(self) -> None:
        lengths = np.array([self.first_m, self.second_m])
        if not (np.isfinite(lengths).all() and (lengths > SHORTEST_M).all() and (lengths < LONGEST_M).all()):
            raise WandInvalid(
                f"The wand's lights are {self.first_m} and {self.second_m} m apart; "
                f"{SHORTEST_M} to {LONGEST_M} m are possible.",
                hint="Lengths are in metres: --wand 0.13 0.26",
            )
        if self.short_share > SURE_SHARE - 0.03:
            raise WandInvalid(
                f"The wand's parts of {self.first_m:.3f} and {self.second_m:.3f} m are too alike to "
                "distinguish its ends.",
                hint="Put the middle light at a third of the wand, as 0.13 and 0.26 m.",
            )

    @property
    def short_share(self) -> float:
        """The shorter part's share of the wand."""
        return min(self.first_m, self.second_m) / (self.first_m + self.second_m)

    @property
    def lights(self) -> Float[np.ndarray, "3 3"]:
        """(3, 3) metres, the lights on the X axis about their mean."""
        x = np.array([0.0, self.first_m, self.first_m + self.second_m])
        return np.stack([x - x.mean(), np.zeros(3), np.zeros(3)], axis=1)

    @property
    def distances_m(self) -> Float[np.ndarray, " 3"]:
        """(3,) first to middle, middle to third, first to third."""
        return np.array([self.first_m, self.second_m, self.first_m + self.second_m])


def distances(lights: Float[np.ndarray, "*batch 3 axes"]) -> Float[np.ndarray, "*batch 3"]:
    """Return the distances first to middle, middle to third, first to third of lights in their order."""
    return np.linalg.norm(lights[..., [1, 2, 2], :] - lights[..., [0, 1, 0], :], axis=-1)


def identified(wand: Wand, flat: Float[np.ndarray, "frames 3 2"], sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Return which of three spots is which light, (F, 3) indices, and whether that is sure, (F,).

    The middle light lies between the others. Of the ends, the one on the shorter part's side is nearer to it, which
    perspective turns around only where the wand points at the camera.

    Args:
        flat: (F, 3, 2) undistorted normalised coordinates in any order, NaN where there are fewer.
        sigma: standard deviation of a coordinate, normalised units.
    """
    rows = np.arange(len(flat))
    known = np.isfinite(flat).all((-1, -2))
    spots = np.where(known[:, None, None], flat, 0.0)
    # Of three points on a line the middle one is opposite to the longest distance.
    across = np.linalg.norm(spots[:, [1, 2, 0]] - spots[:, [2, 0, 1]], axis=-1)
    middle = np.argmax(across, axis=1)
    ends = (middle[:, None] + np.array([1, 2])) % 3
    parts = np.linalg.norm(spots[rows[:, None], ends] - spots[rows, middle][:, None], axis=-1)
    swap = (parts[:, 0] > parts[:, 1]) != (wand.first_m > wand.second_m)
    ends = np.where(swap[:, None], ends[:, ::-1], ends)
    order = np.stack([ends[:, 0], middle, ends[:, 1]], axis=1)
    first, mid, third = (spots[rows, order[:, i]] for i in range(3))
    length = np.linalg.norm(third - first, axis=-1)
    along = (third - first) / np.maximum(length, 1e-12)[:, None]
    arm = mid - first
    off = np.abs(along[:, 0] * arm[:, 1] - along[:, 1] * arm[:, 0])
    straight = off < np.maximum(STRAIGHT * length, STRAIGHT_SIGMAS * sigma)
    sure = parts.min(axis=1) < SURE_SHARE * parts.sum(axis=1)
    return order, known & straight & sure & (length > 8.0 * sigma)


def in_order(px: Float[np.ndarray, "frames 3 2"], order: np.ndarray, sure: np.ndarray) -> np.ndarray:
    """Return (F, 3, 2) spots as lights in the wand's order, NaN where it is not sure which they are."""
    return np.where(sure[:, None, None], np.take_along_axis(px, order[..., None], axis=1), np.nan)


def middle_from_lights(wand: Wand, flat: Float[np.ndarray, "frames 3 2"]) -> Float[np.ndarray, "frames 3"]:
    """Return where the middle light is, (F, 3) metres in a camera's axes, from one picture of the wand.

    Lights on a line, ``z₂ r₂ = (1 - q) z₁ r₁ + q z₃ r₃`` with ``q = d₁₂ / d₁₃``, give the proportions of their depths
    (the null vector of three rays), the wand's length their size. Depths are rough. Ways across the sight are sure.

    Args:
        flat: (F, 3, 2) undistorted normalised coordinates of the lights in their order, NaN where not seen.
    """
    known = np.isfinite(flat).all((-1, -2))
    spots = np.where(known[:, None, None], flat, np.array([[-0.1, 0.0], [0.0, 0.0], [0.2, 0.0]]))
    rays = np.concatenate([spots, np.ones((*spots.shape[:2], 1))], axis=-1)
    q = wand.first_m / wand.distances_m[2]
    rows = rays * np.array([1.0 - q, -1.0, q])[:, None]
    z = np.linalg.svd(np.swapaxes(rows, 1, 2))[2][:, -1]
    z = z * np.sign(z[:, 1:2] + 1e-12)
    length = np.linalg.norm(z[:, 2:] * rays[:, 2] - z[:, :1] * rays[:, 0], axis=-1)
    size = wand.distances_m[2] / np.maximum(length, 1e-9)
    return np.where(known[:, None], (size * z[:, 1])[:, None] * rays[:, 1], np.nan)


EXACT_SHARE = 0.01
"""A moment this near a frame, as a share of the interval, is that frame."""
LONGEST_GAP = 1.5
"""Frames further apart than this many usual intervals are a gap, where nothing is interpolated."""


def values_and_velocities(
    values: Float[np.ndarray, "frames ..."],
    times_s: Float[np.ndarray, " frames"],
    wanted_s: Float[np.ndarray, " moments"],
) -> tuple[Float[np.ndarray, "moments ..."], Float[np.ndarray, "moments ..."]]:
    """Return a track's values and their rates of change at wanted times.

    Values are those of the frame where a moment is one. Else of Hermite's cubic between both neighbours, whose slopes
    are central differences. Rates are those of the nearest frame. NaN where a frame that is needed is missing.

    Args:
        values: (F, ...), NaN where missing.
        times_s: (F,) seconds, growing.
        wanted_s: (M,) seconds.

    Reference: Catmull and Rom 1974.
    """
    count = len(times_s)
    shape = (len(wanted_s), *values.shape[1:])
    if count < 2:
        return np.full(shape, np.nan), np.full(shape, np.nan)
    usual = float(np.median(np.diff(times_s)))
    after = np.clip(np.searchsorted(times_s, wanted_s), 1, count - 1)
    gap = times_s[after] - times_s[after - 1]
    share = (wanted_s - times_s[after - 1]) / gap
    nearest = after - (share < 0.5)
    exact = np.abs(wanted_s - times_s[nearest]) <= EXACT_SHARE * usual
    inside = (share >= 0) & (share <= 1) & (gap < LONGEST_GAP * usual)
    column = (slice(None), *[None] * (values.ndim - 1))
    slope = _slopes(values, times_s, usual)
    s, width = share[column], gap[column]
    # Hermite's cubic of both frames' values and slopes, which at even spacing is Catmull and Rom's.
    low, high = values[after - 1], values[after]
    between = (
        (1 + 2 * s) * (1 - s) ** 2 * low
        + s**2 * (3 - 2 * s) * high
        + width * s * (1 - s) ** 2 * slope[after - 1]
        - width * s**2 * (1 - s) * slope[after]
    )
    found = np.where(exact[column], values[nearest], np.where(inside[column], between, np.nan))
    return found, np.where((exact | inside)[column], slope[nearest], np.nan)


def _slopes(values: np.ndarray, times_s: np.ndarray, usual: float) -> np.ndarray:
    """Return (F, ...) central differences, NaN at ends, gaps, and beside missing frames."""
    slope = np.full(values.shape, np.nan)
    if len(values) < 3:
        return slope
    span = times_s[2:] - times_s[:-2]
    column = (slice(None), *[None] * (values.ndim - 1))
    whole = (span < 2 * LONGEST_GAP * usual)[column]
    slope[1:-1] = np.where(whole, (values[2:] - values[:-2]) / span[column], np.nan)
    return slope


COLUMNS, ROWS = 6, 4
"""Cells of each picture."""
LEAST_IN_CELL = 5
"""Sightings with which a cell of a picture counts as covered."""
CELL_M = 0.5
"""Edge of the volume's cells."""
_ACROSS, _DOWN = ("left", "middle", "right"), ("top", "middle", "bottom")


@dataclass
class Coverage:
    """Counts that grow while the wand is waved. ``add`` is what a live view calls for each moment."""

    names: tuple[str, ...]
    size_px: Int[np.ndarray, "views 2"]
    """(C, 2) width and height."""
    pictures: np.ndarray = field(init=False)
    """(C, ROWS, COLUMNS) sightings."""
    volume: dict[tuple[int, int, int], int] = field(init=False, default_factory=dict)
    """Moments by cell of ``CELL_M`` where the wand was located."""

    def __post_init__(self) -> None:
        self.pictures = np.zeros((len(self.names), ROWS, COLUMNS), dtype=np.int64)

    def add(self, px: Float[np.ndarray, "views moments 2"], at: Float[np.ndarray, "moments 3"] | None = None) -> None:
        """Count moments.

        Args:
            px: (C, M, 2) where the wand is, NaN where a sensor does not see it.
            at: (M, 3) metres, where sensors stand is known already. NaN where it is not located.
        """
        view, moment = np.nonzero(np.isfinite(px).all(-1))
        share = px[view, moment] / self.size_px[view]
        cell = np.clip((share * [COLUMNS, ROWS]).astype(int), 0, [COLUMNS - 1, ROWS - 1])
        np.add.at(self.pictures, (view, cell[:, 1], cell[:, 0]), 1)
        if at is None:
            return
        cells, counts = np.unique(np.floor(at[np.isfinite(at).all(1)] / CELL_M).astype(int), axis=0, return_counts=True)
        for key, count in zip(map(tuple, cells.tolist()), counts.tolist(), strict=True):
            self.volume[key] = self.volume.get(key, 0) + count

    @property
    def shares(self) -> Float[np.ndarray, " views"]:
        """(C,) share of each picture's cells that are covered."""
        return (self.pictures >= LEAST_IN_CELL).mean(axis=(1, 2))

    @property
    def volume_m3(self) -> float:
        """Volume of the cells where the wand was located."""
        return len(self.volume) * CELL_M**3

    def next_place(self) -> str:
        """Return the part of a picture to wave in, of the sensor that saw least; "" when all is covered."""
        open_cells = self.pictures < LEAST_IN_CELL
        if not open_cells.any():
            return ""
        c = int(np.argmax(open_cells.sum(axis=(1, 2))))
        rows, columns = np.nonzero(open_cells[c])
        # Thirds of the picture, the one with most open cells first.
        parts = 3 * (rows * 3 // ROWS) + columns * 3 // COLUMNS
        down, across = divmod(int(np.bincount(parts, minlength=9).argmax()), 3)
        place = "middle" if down == across == 1 else f"{_DOWN[down]} {_ACROSS[across]}"
        return f"Wave in the {place} of what {self.names[c]} sees: {1 - self.shares[c]:.0%} of its picture is open."

    def lines(self) -> list[str]:
        """Return a row for each sensor: its picture's cells, ``#`` covered, ``+`` seen, ``.`` open."""
        rows = []
        for name, grid, share in zip(self.names, self.pictures, self.shares, strict=True):
            marks = ["".join("#" if n >= LEAST_IN_CELL else "+" if n else "." for n in row) for row in grid]
            rows.append(f"{name:<11} {share:4.0%} of the picture  {' '.join(marks)}")
        return rows


def coverage_of(
    cameras: Cameras, px: Float[np.ndarray, "views moments lights 2"], at: Float[np.ndarray, "moments lights 3"]
) -> Coverage:
    """Return the coverage of a whole recording, by the wand's middle."""
    found = Coverage(cameras.names, cameras.image_size)
    found.add(px.mean(axis=2), at.mean(axis=1))
    return found
