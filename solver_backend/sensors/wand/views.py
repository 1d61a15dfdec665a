"""Read wand recordings, identify the wand's lights, and measure its coverage of the images."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from solver_backend.camera_calibration.adjustment.lens import Lens, lens_of
from solver_backend.camera_calibration.intrinsics.known_lenses import known_lenses
from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CalibrationMissing, CommandLineInvalid, FileDamaged, FileMissing, MocapError
from solver_backend.exchange.plausible import FARTHEST_M, FARTHEST_PX, LONGEST_S
from solver_backend.exchange.progress import Progress, silent
from solver_backend.io.calibration.read import read_calibration
from solver_backend.io.camera_names import natural_key
from solver_backend.io.files import read_text
from solver_backend.sensors.acquisition.acquire import Acquisition, SensorSightings
from solver_backend.sensors.chain import masks_of
from solver_backend.sensors.devices.recorded import ABOUT, STUDIO_SHOT, SensorFolder, open_folder
from solver_backend.types import Cameras
from solver_backend.types.shapes import Bool, Float, Int
from solver_backend.videos.sync.clocks import EXACT_SHARE


class WandNotSeen(MocapError):
    """A sensor never saw the wand, or never saw it at the same time as another sensor."""


class WandAmbiguous(MocapError):
    """More than one wand was visible, or another light."""


class WandInvalid(MocapError):
    """The wand's lengths do not distinguish its lights, or do not fit the images."""


class TimesInvalid(MocapError):
    """The timestamps in a recording do not increase."""


LARGEST_LEFT_OUT = 0.2  # Largest fraction of rows that go back in time in a usable recording. Chosen by hand.


@dataclass(frozen=True)
class WandView:
    """One sensor's recording of a wand with K lights."""

    name: str
    lens: Lens
    times_s: Float[np.ndarray, " frames"]  # (F,) increasing times in seconds on the sensor's clock.
    px: Float[np.ndarray, "frames lights 2"]
    """(F, K, 2) pixels, NaN where a light is missing or other lights are visible."""
    depth_m: Float[np.ndarray, "frames lights"] | None = None
    """(F, K) depth in metres along the optical axis, NaN where unknown. None if the sensor has no depth."""
    crowded: int = 0  # Number of frames that show other lights.
    findings: tuple[Diagnostic, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "px", np.where(np.abs(self.px) <= FARTHEST_PX, self.px, np.nan))
        if self.depth_m is not None:
            within = (self.depth_m > 0) & (self.depth_m <= FARTHEST_M)
            object.__setattr__(self, "depth_m", np.where(within, self.depth_m, np.nan))

    @property
    def depth_or_nan(self) -> np.ndarray:
        """(F, K) depth in metres. All values are NaN if the sensor has no depth."""
        return np.full(self.px.shape[:2], np.nan) if self.depth_m is None else self.depth_m

    def __len__(self) -> int:
        return len(self.times_s)


@dataclass(frozen=True)
class Moments:
    """Recordings of C sensors, sampled at M common times."""

    times_s: Float[np.ndarray, " moments"]  # (M,) times in seconds on the first view's clock.
    px: Float[np.ndarray, "views moments lights 2"]  # (C, M, K, 2) pixels, NaN where missing.
    velocity: Float[np.ndarray, "views moments lights 2"]  # (C, M, K, 2) velocity in px/s, NaN where unknown.
    depth_m: Float[np.ndarray, "views moments lights"]  # (C, M, K) depths in metres, NaN where unknown.

    @property
    def seen(self) -> Bool[np.ndarray, "views moments"]:
        """(C, M) mask of the times at which a sensor sees the whole wand."""
        return np.isfinite(self.px).all((-1, -2))

    def where(self, chosen: np.ndarray) -> Moments:
        """Select some of the common times by a mask or by their indices."""
        return Moments(self.times_s[chosen], self.px[:, chosen], self.velocity[:, chosen], self.depth_m[:, chosen])


def with_growing_times(view: WandView) -> WandView:
    """Remove rows that go back in time. Raise ``TimesInvalid`` if there are many, or if the recording is too long."""
    times = view.times_s
    before = np.r_[-np.inf, np.maximum.accumulate(np.where(np.isfinite(times), times, -np.inf))[:-1]]
    good = np.isfinite(times) & (times > before)
    lost = int((~good).sum())
    if not good.any() or lost > LARGEST_LEFT_OUT * len(times):
        first = float(times[int(np.argmin(good))]) if len(times) else float("nan")
        message = f"{lost} of {len(times)} rows go backwards in time, the first at {first:.3f} s."
        hint = "If the sensor was restarted, put each recording in its own file."
        raise TimesInvalid(message, where=f"sensor {view.name}", hint=hint)
    first, last = times[good][[0, -1]].tolist()
    if not last - first <= LONGEST_S:
        message = f"The rows span {last - first:.3g} s."
        raise TimesInvalid(message, where=f"sensor {view.name}", hint="Write the times in nanoseconds.")
    if not lost:
        return view
    after = float(before[int(np.argmin(good))])
    back = diagnostic("wand_rows_ignored", reason="back", cameras=[view.name], lost=lost, after=after)
    depth, findings = None if view.depth_m is None else view.depth_m[good], (*view.findings, back)
    return replace(view, times_s=times[good], px=view.px[good], depth_m=depth, findings=findings)


SURE_SHARE = 0.43  # Largest fraction of the shorter part in the visible wand that still distinguishes the ends.
STRAIGHT, STRAIGHT_SIGMAS = 0.03, 4.0
"""Largest distance from the middle light to the line through the other two: as a fraction of the visible wand, or in
standard deviations of a pixel position."""
SHORTEST_M, LONGEST_M = 0.02, 5.0  # Limits in metres for the distance between neighbouring lights. Chosen by hand.


@dataclass(frozen=True)
class Wand:
    """A wand with three lights. The distances between neighbouring lights are in metres."""

    first_m: float
    second_m: float

    def __post_init__(self) -> None:
        parts = np.array([self.first_m, self.second_m])
        if not ((parts > SHORTEST_M) & (parts < LONGEST_M)).all():
            possible = f"{SHORTEST_M} to {LONGEST_M} m are possible"
            message = f"The wand's lights are {self.first_m} and {self.second_m} m apart. {possible}."
            raise WandInvalid(message, hint="Specify the lengths in metres (--wand 0.13 0.26).")
        if self.short_share > SURE_SHARE - 0.03:
            lengths = f"{self.first_m:.3f} and {self.second_m:.3f} m"
            message = f"The parts of the wand, {lengths}, are too similar to distinguish its ends."
            hint = "Put the middle light a third of the way along the wand, such as 0.13 and 0.26 m from the ends."
            raise WandInvalid(message, hint=hint)

    @property
    def short_share(self) -> float:
        """Length of the shorter part as a fraction of the wand."""
        return min(self.first_m, self.second_m) / (self.first_m + self.second_m)

    @property
    def lights(self) -> Float[np.ndarray, "3 3"]:
        """(3, 3) positions of the lights in metres, on the X axis and relative to their mean."""
        x = np.array([0.0, self.first_m, self.first_m + self.second_m])
        return np.stack([x - x.mean(), np.zeros(3), np.zeros(3)], axis=1)

    @property
    def distances_m(self) -> Float[np.ndarray, " 3"]:
        """(3,) distances in metres: first to middle, middle to third, and first to third light."""
        return np.array([self.first_m, self.second_m, self.first_m + self.second_m])


def distances(lights: Float[np.ndarray, "*batch 3 axes"]) -> Float[np.ndarray, "*batch 3"]:
    """Return the (..., 3) distances between ordered lights: 1 to 2, 2 to 3, and 1 to 3."""
    return np.linalg.norm(lights[..., [1, 2, 2], :] - lights[..., [0, 1, 0], :], axis=-1)


def identified(wand: Wand, flat: Float[np.ndarray, "frames 3 2"], sigma: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the (F, 3) indices of the wand's lights, and the (F,) mask of frames in which the indices are certain.

    The middle light is between the other two. It is nearer to the end of the wand's shorter part, unless the wand
    points at the camera and perspective reverses this. ``flat`` are undistorted normalised coordinates of the lights in
    any order, with the standard deviation ``sigma``. They are NaN if fewer than three lights are visible.
    """
    rows = np.arange(len(flat))
    known = np.isfinite(flat).all((-1, -2))
    spots = np.where(known[:, None, None], flat, 0.0)
    # The middle one of three points on a line is opposite the longest distance.
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
    """Sort spots (F, 3, 2) in the wand's order. Uncertain frames are NaN."""
    return np.where(sure[:, None, None], np.take_along_axis(px, order[..., None], axis=1), np.nan)


def middle_from_lights(wand: Wand, flat: Float[np.ndarray, "frames 3 2"]) -> Float[np.ndarray, "frames 3"]:
    """Estimate the (F, 3) position of the middle light in camera axes in metres, from single images.

    The lights are on a line, so ``z₂ r₂ = (1 - q) z₁ r₁ + q z₃ r₃`` with ``q = d₁₂ / d₁₃``. The null vector of the
    three rays gives the ratios between the depths, and the wand's length gives the scale. The depths are approximate.
    ``flat`` are undistorted normalised coordinates in the wand's order, NaN where missing.
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


LONGEST_GAP = 1.5  # Longest interval across which values are interpolated, in usual intervals.


def values_and_velocities(
    values: np.ndarray, times_s: np.ndarray, wanted_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate a track (F, ...) at other times. Also return the track's velocity at the nearest frames.

    Cubic Hermite polynomials interpolate between frames, with central differences as slopes (Catmull and Rom 1974).
    Results are NaN if a required frame is missing.
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
    # Cubic Hermite polynomial from the values and slopes at both frames. For equal intervals, it is Catmull and Rom's.
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
    """Return (F, ...) central differences, NaN at the ends, in gaps and next to missing frames."""
    slope = np.full(values.shape, np.nan)
    if len(values) < 3:
        return slope
    span = times_s[2:] - times_s[:-2]
    column = (slice(None), *[None] * (values.ndim - 1))
    whole = (span < 2 * LONGEST_GAP * usual)[column]
    slope[1:-1] = np.where(whole, (values[2:] - values[:-2]) / span[column], np.nan)
    return slope


COLUMNS, ROWS = 6, 4  # Number of cells across and down an image.
LEAST_IN_CELL = 5  # Smallest number of sightings in a covered image cell. Chosen by hand.
CELL_M = 0.5  # Edge length in metres of the cells of the capture volume.
_ACROSS, _DOWN = ("left", "middle", "right"), ("top", "middle", "bottom")


@dataclass
class Coverage:
    """Number of wand sightings in each part of the images and of the capture volume."""

    names: tuple[str, ...]
    size_px: Int[np.ndarray, "views 2"]  # (C, 2) image width and height.
    pictures: np.ndarray = field(init=False)  # (C, ROWS, COLUMNS) number of sightings.
    volume: set[tuple[int, ...]] = field(init=False, default_factory=set)  # Cells in which the wand was located.

    def __post_init__(self) -> None:
        self.pictures = np.zeros((len(self.names), ROWS, COLUMNS), dtype=np.int64)

    def add(self, px: Float[np.ndarray, "views moments 2"], at: Float[np.ndarray, "moments 3"] | None = None) -> None:
        """Count the wand's image points per image cell, and its positions ``at``, if given, per volume cell."""
        view, moment = np.nonzero(np.isfinite(px).all(-1))
        share = px[view, moment] / self.size_px[view]
        cell = np.clip((share * [COLUMNS, ROWS]).astype(int), 0, [COLUMNS - 1, ROWS - 1])
        np.add.at(self.pictures, (view, cell[:, 1], cell[:, 0]), 1)
        if at is not None:
            self.volume |= set(map(tuple, np.floor(at[np.isfinite(at).all(1)] / CELL_M).astype(int).tolist()))

    @property
    def shares(self) -> Float[np.ndarray, " views"]:
        """(C,) fraction of cells covered in each image."""
        return (self.pictures >= LEAST_IN_CELL).mean(axis=(1, 2))

    @property
    def volume_m3(self) -> float:
        """Volume in m³ of the cells that contained the wand."""
        return len(self.volume) * CELL_M**3

    def next_place(self) -> str:
        """Describe the least covered part of the least covered image. Return "" if all are covered."""
        open_cells = self.pictures < LEAST_IN_CELL
        if not open_cells.any():
            return ""
        c = int(np.argmax(open_cells.sum(axis=(1, 2))))
        rows, columns = np.nonzero(open_cells[c])
        # Count the uncovered cells in each third of the image.
        parts = 3 * (rows * 3 // ROWS) + columns * 3 // COLUMNS
        down, across = divmod(int(np.bincount(parts, minlength=9).argmax()), 3)
        place = "middle" if down == across == 1 else f"{_DOWN[down]} {_ACROSS[across]}"
        return f"Wave in the {place} of {self.names[c]}'s view, of which {1 - self.shares[c]:.0%} is not covered."

    def lines(self) -> list[str]:
        """Return a map of image cells per sensor: ``#`` covered, ``+`` too few sightings, ``.`` no sighting."""
        rows = []
        for name, grid, share in zip(self.names, self.pictures, self.shares, strict=True):
            marks = ["".join("#" if n >= LEAST_IN_CELL else "+" if n else "." for n in row) for row in grid]
            rows.append(f"{name:<11} {share:4.0%} of the image  {' '.join(marks)}")
        return rows


def is_sensor_folder(path: Path) -> bool:
    """Return whether a folder contains a sensor recording or a studio shot."""
    return (path / ABOUT).is_file() or all((path / name).exists() for name in STUDIO_SHOT)


def sensor_views(
    folder: SensorFolder, masks: Mapping[str, np.ndarray] = MappingProxyType({}), progress: Progress = silent
) -> list[WandView]:
    """Read the sensors' recordings of a single marker. Frames with several markers are counted as ``crowded``.

    Raises:
        PicturesDiffer: infrared images, depth images and calibration have different sizes.
        RecordingInvalid, SensorFailed: the recording is damaged.
        TimesInvalid: a sensor's times do not increase.
    """
    views = []
    for index, name in enumerate(folder.cameras.names):
        rows, crowded = [], 0
        for seen in sightings_of(folder, folder.cameras, name, masks):
            alone = len(seen) == 1
            crowded += len(seen) > 1
            px, depth = (seen.px[0], seen.depth[0]) if alone else (np.full(2, np.nan), np.nan)
            rows.append((seen.time, *px, depth))
            progress(f"The wand before {name}", len(rows), len(rows))
        if rows:
            table = np.array(rows)
            lens = lens_of(folder.cameras, index)
            view = WandView(name, lens, table[:, 0], table[:, None, 1:3], table[:, 3:], crowded)
            views.append(with_growing_times(view))
    return views


def sensor_clouds(path: Path, cameras: Cameras, empty: Path | None = None) -> list[np.ndarray]:
    """Return the points (N, 3) in metres of each frame with three or more markers, for all sensors."""
    folder, masks = open_folder(path), {} if empty is None else masks_of(open_folder(empty))
    clouds = []
    for name in folder.cameras.names:
        for seen in sightings_of(folder, cameras, name, masks):
            points = seen.points[np.isfinite(seen.points).all(1)]
            if len(points) >= 3:
                clouds.append(points)
    return clouds


def sightings_of(
    folder: SensorFolder, cameras: Cameras, name: str, masks: Mapping[str, np.ndarray] = MappingProxyType({})
) -> Iterator[SensorSightings]:
    """Yield the markers that one sensor sees in each frame, or nothing if the folder lacks the sensor."""
    device = next((device for device in folder.devices if device.name == name), None)
    if device is None:
        return
    find = Acquisition(cameras, name, masks.get(name))
    yield from (find(frame) for frame in device.frames())


DEPTH_HEADER = "t_ns;u;v;depth_mm"
LENS_SUFFIXES = (".yaml", ".yml", ".toml")
LIGHTS_COLUMNS, DEPTH_COLUMNS = 7, 4


def points_files(folder: Path) -> list[Path]:
    """Return the point tables (.csv) in a folder, in natural order."""
    return sorted(folder.glob("*.csv"), key=lambda path: natural_key(path.name)) if folder.is_dir() else []


def read_points_folder(folder: Path, lenses: Mapping[str, Lens] | None = None) -> list[WandView]:
    """Read the wand tables ``NAME.csv`` in a folder, with a lens for each sensor.

    Raises:
        FileMissing: there is no table.
        CalibrationMissing: the lens of a sensor is missing.
        FileDamaged: a row has neither of the two formats, or the formats of the tables differ.
    """
    files = points_files(folder)
    if not files:
        raise FileMissing("The folder has no wand table (.csv). Choose a wand recording.", where=str(folder))
    views = [_view(path, lens_beside(path, lenses)) for path in files]
    if len({view.depth_m is None for view in views}) > 1:
        message, hint = "Some tables have depth, and others have three lights.", "Put them in separate folders."
        raise FileDamaged(message, where=str(folder), hint=hint)
    return [with_growing_times(view) for view in views]


def lens_beside(path: Path, lenses: Mapping[str, Lens] | None) -> Lens:
    """Return a sensor's lens, from ``lenses`` or from a file next to its table."""
    name = path.stem
    if lenses is not None and name in lenses:
        return lenses[name]
    beside = next((p for s in LENS_SUFFIXES if (p := path.with_suffix(s)).is_file()), None)
    if beside is None:
        hint = f"Put it next to the table as {name}.yaml, or specify --lenses FILE."
        raise CalibrationMissing("The lens of the sensor is unknown.", where=f"sensor {name}", hint=hint)
    return lens_of(read_calibration(beside).cameras, 0)


def read_table(path: Path) -> tuple[np.ndarray, bool]:
    """Read the rows of a wand or Γ table, and return whether they include depth."""
    text = read_text(path)
    first = text.split("\n", 1)[0].strip().lstrip("\ufeff").replace(" ", "").lower()
    with_depth = first == DEPTH_HEADER
    if not with_depth and first[:1].isalpha():
        hint = f"Write '{DEPTH_HEADER}' for a marker with depth. Omit it for three lights."
        raise FileDamaged(f"The first line is '{first[:60]}'.", where=str(path), hint=hint)
    columns, skip = DEPTH_COLUMNS if with_depth else LIGHTS_COLUMNS, int(with_depth)
    if not text.strip() or len(text.splitlines()) <= skip:
        raise FileDamaged("The table is empty.", where=str(path))
    try:
        table = np.loadtxt(io.StringIO(text), delimiter=";", skiprows=skip, ndmin=2)
    except ValueError as error:
        raise FileDamaged(f"A row is not numbers separated by semicolons: {error}.", where=str(path)) from error
    if table.shape[1] != columns:
        raise FileDamaged(f"Rows have {table.shape[1]} numbers, but {columns} are expected.", where=str(path))
    return table, with_depth


def _view(path: Path, lens: Lens) -> WandView:
    """Read a sensor's wand table. Times with several rows show other lights, and are counted as ``crowded``."""
    table, with_depth = read_table(path)
    if not with_depth:
        px = table[:, 1:].reshape(-1, 3, 2)
        return WandView(path.stem, lens, 1e-9 * table[:, 0], np.where((px < 0).any(-1, keepdims=True), np.nan, px))
    starts = np.flatnonzero(np.r_[True, table[1:, 0] != table[:-1, 0]])
    alone = np.diff(np.r_[starts, len(table)]) == 1
    rows = table[starts]
    seen = alone & np.isfinite(rows[:, 1:3]).all(1) & (rows[:, 1:3] >= 0).all(1)
    px = np.where(seen[:, None], rows[:, 1:3], np.nan)[:, None]
    depth = np.where(seen & (rows[:, 3] > 0), 1e-3 * rows[:, 3], np.nan)[:, None]
    return WandView(path.stem, lens, 1e-9 * rows[:, 0], px, depth, crowded=int((~alone).sum()))


def wand_views(
    folder: Path, lenses: Path | None, *, lights: bool, empty: Path | None = None, progress: Progress = silent
) -> list[WandView]:
    """Read the recordings of a wand, with lenses from ``lenses`` or from files next to the tables.

    Raises:
        FileMissing: there is no recording.
        CommandLineInvalid: the wand has one marker although ``lights`` is true, or three lights although it is false.
    """
    if not folder.exists():
        raise FileMissing("There is no such folder.", where=str(folder))
    if is_sensor_folder(folder):
        if lights:
            message = "The folder is a depth sensor recording, and depth sensors see one marker."
            raise CommandLineInvalid(message, where=str(folder), hint="Omit --wand.")
        masks = {} if empty is None else masks_of(open_folder(empty))
        return sensor_views(open_folder(folder, lenses), masks, progress)
    files = points_files(folder)
    known = None if lenses is None else known_lenses(lenses, tuple(path.stem for path in files))
    progress("Tables of the wand", 0, 1)
    views = read_points_folder(folder, known)
    if lights == (views[0].depth_m is not None):
        message, hint = "The tables contain one marker with depth, so the wand has no lengths.", "Omit --wand."
        if not lights:
            message = "The tables contain a wand with three lights and no depth."
            hint = "Specify its lengths in metres (--wand 0.13 0.26)."
        raise CommandLineInvalid(message, where=str(folder), hint=hint)
    return views
