"""Calibrate sensors and their clocks from recordings of a waved wand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver_backend.agreement.lags import Signal
from solver_backend.camera_calibration.adjustment.bundle import (
    CAMERA_PARAMETERS,
    Adjusted,
    Bodies,
    BodySightings,
    Unknowns,
    adjust,
)
from solver_backend.camera_calibration.adjustment.lens import build_cameras
from solver_backend.camera_calibration.extrinsics.two_views import (
    CalibratedCameras,
    Pair,
    Pose,
    chained,
    essential_matrix,
    intersected,
    moved_world,
    pose_from_essential,
    result_of,
)
from solver_backend.cameras.projection import project, undistort
from solver_backend.exchange.diagnostics import Severity, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.exchange.progress import Progress, silent
from solver_backend.geometry.alignment import umeyama
from solver_backend.sensors.acquisition.blobs import SETTINGS
from solver_backend.sensors.wand.evaluation import WandCalibration, WandOptions, findings_of, notes_of
from solver_backend.sensors.wand.views import (
    Coverage,
    Moments,
    Wand,
    WandAmbiguous,
    WandInvalid,
    WandNotSeen,
    WandView,
    distances,
    identified,
    in_order,
    middle_from_lights,
    values_and_velocities,
)
from solver_backend.types import Cameras
from solver_backend.types.shapes import Float
from solver_backend.videos.sync.clocks import Clocks, SyncUnknown, at_times, clocks_of_signals, smoothed
from solver_backend.videos.sync.synchronise import REACH_S, ROLLING_SHUTTER, SPEED_RATE_HZ, in_step

SIGMA_PX = 0.3  # Standard deviation in pixels of a detected light or marker. It sets the robust scales.
STEPS, TOLERANCE = 60, 1e-6
HELD_OUT_BLOCKS = 10  # Number of time ranges of a recording. Every fifth one is held out.


@dataclass(frozen=True)
class WandTask:
    """Input of the bundle adjustment for a wand."""

    cameras: Cameras  # C cameras with their lenses and initial poses.
    lights: np.ndarray  # (K, 3) positions in metres relative to the wand's centre, zero for a single marker.
    find_delays: bool
    delays: np.ndarray  # (C,) known or initial delays in seconds.


def cameras_at(views: Sequence[WandView], poses: Sequence[tuple[np.ndarray, np.ndarray]]) -> Cameras:
    """Build cameras from the lenses of the views and the given poses."""
    R, t = np.stack([R for R, _ in poses]), np.stack([t for _, t in poses])
    return build_cameras([view.name for view in views], [view.lens for view in views], R, t)


def adjusted(task: WandTask, moments: Moments) -> tuple[Adjusted, np.ndarray]:
    """Refine cameras and wand poses by bundle adjustment. Return the result and the used frames.

    The world has the first sensor's axes. A single marker does not determine the scale (see ``depth_scale``).

    Reference: Triggs et al. 2000.
    """
    at = triangulated(task.cameras, moments, task.delays)
    usable = moments.seen & (np.isfinite(moments.velocity).all((-1, -2)) | (not task.find_delays))
    used = np.flatnonzero(np.isfinite(at).all((1, 2)) & (usable.sum(0) >= 2))
    rigid = len(task.lights) > 1
    if rigid:
        _, R, t = umeyama(np.broadcast_to(task.lights, at[used].shape), at[used])
    else:
        R, t = np.tile(np.eye(3), (len(used), 1, 1)), at[used, 0]
    camera, moment, light = np.nonzero(np.broadcast_to(usable[:, used, None], (*usable[:, used].shape, at.shape[1])))
    pick = camera, used[moment], light
    velocity = np.nan_to_num(moments.velocity[pick]) if task.find_delays or task.delays.any() else None
    sigma = np.full(len(camera), SIGMA_PX)
    seen = BodySightings(camera, moment, task.lights[light], moments.px[pick], sigma, velocity)
    others = np.arange(len(task.cameras)) > 0
    unknowns = Unknowns(others, delays=others if task.find_delays else None)
    options = {"steps": STEPS, "tolerance": TOLERANCE, "gauge": 0 if rigid else 1}
    return adjust(task.cameras, Bodies(R, t), seen, unknowns, delays=task.delays, **options), used


def triangulated(cameras: Cameras, moments: Moments, delays: np.ndarray) -> np.ndarray:
    """Triangulate the lights, with known camera delays. Return (M, K, 3) positions in metres."""
    px = in_step_px(moments, delays)
    flat = undistort(cameras, px)
    return intersected(cameras.R, cameras.t, flat.reshape(len(cameras), -1, 2)).reshape(*px.shape[1:3], 3)


def in_step_px(moments: Moments, delays: np.ndarray) -> np.ndarray:
    """Correct the pixels (C, M, K, 2) of moving lights for the camera delays, ``px - v δ``."""
    return moments.px - moments.velocity * delays[:, None, None, None] if delays.any() else moments.px


def held_out(count: int) -> np.ndarray:
    """Return the (M,) mask of the held-out frames, which form separate time ranges."""
    return np.arange(count) * HELD_OUT_BLOCKS // max(count, 1) % 5 == 2


LEAST_TOGETHER = 20  # Minimum number of frames that a pair of sensors must have in common.
HYPOTHESES = 200  # Number of random samples of three point pairs.
_REFINEMENTS = 15  # Number of reweighted alignments. Chosen by hand.
START_SIGMA_PX = 2.0  # Initial scale in pixels of the distances from epipolar lines.


def robust_umeyama(
    source: np.ndarray, target: np.ndarray, sigma: np.ndarray, rng: np.random.Generator
) -> tuple[Pose, np.ndarray]:
    """Return the rigid transform from source to target points (n, 3), and the (n,) mask of inliers.

    Samples of three pairs provide hypotheses (Fischler and Bolles 1981). The best one is refined with Cauchy's penalty
    on ``|R x + t - y| / σ`` (Umeyama 1991). ``sigma`` (n,) are the standard deviations of the distances between paired
    points. Lengths are in metres.
    """
    picks = np.stack([rng.permutation(len(source))[:3] for _ in range(HYPOTHESES)])
    _, R, t = umeyama(source[picks], target[picks])
    square = ((np.einsum("hij,nj->hni", R, source) + t[:, None] - target) ** 2).sum(-1) / sigma**2
    best = int(np.argmin(np.log1p(square / 9.0).sum(-1)))
    R, t, square = R[best], t[best], square[best]
    for _ in range(_REFINEMENTS):
        weight = 1.0 / (1.0 + square / 9.0) / sigma**2
        _, R, t = umeyama(source, target, weight)
        square = ((source @ R.T + t - target) ** 2).sum(-1) / sigma**2
    return (R, t), square < 25.0


def _poses_by_depth(
    names: Sequence[str], points: np.ndarray, sigma: np.ndarray, rng: np.random.Generator
) -> list[Pose]:
    """Estimate each sensor's pose relative to the first from (C, M, 3) marker positions in metres.

    Positions are in each sensor's axes, NaN where missing. Their standard deviations are (C, M).
    """

    def pair(i: int, j: int, both: np.ndarray) -> tuple[Pose, int]:
        spread = np.hypot(sigma[i, both], sigma[j, both])
        pose, agree = robust_umeyama(points[i, both], points[j, both], spread, rng)
        return pose, int(agree.sum())

    return _chained(names, points, pair)


def _poses_by_lights(
    names: Sequence[str], flat: np.ndarray, focal_px: float, wand: Wand, rng: np.random.Generator
) -> list[Pose]:
    """Estimate each camera's pose relative to the first. The wand's lengths set the scale in metres.

    ``flat`` contains (C, M, 3, 2) undistorted normalised coordinates of the ordered lights, NaN where missing.
    """

    def pair(i: int, j: int, both: np.ndarray) -> tuple[Pose, int]:
        first, second = flat[i, both].reshape(-1, 2), flat[j, both].reshape(-1, 2)
        E, agree = essential_matrix(first, second, START_SIGMA_PX / focal_px, rng)
        R, t = pose_from_essential(E, first[agree], second[agree])
        at = intersected(np.stack([np.eye(3), R]), np.stack([np.zeros(3), t]), np.stack([first, second]))
        seen = np.nanmedian(distances(at.reshape(-1, 3, 3)), axis=0)
        return (R, wand.distances_m[2] / max(float(seen[2]), 1e-9) * t), int(agree.sum())

    return _chained(names, flat, pair)


def _require_proportion(wand: Wand, measured_m: Float[np.ndarray, " 3"]) -> None:
    """Raise WandInvalid if the middle light's measured position differs by over 10 % from the wand's description."""
    share = float(min(measured_m[:2]) / measured_m[:2].sum())
    if abs(share / wand.short_share - 1.0) > 0.1:
        message = f"The middle light divides the wand at {share:.3f}, but the lengths give {wand.short_share:.3f}."
        hint = "Measure the wand from light to light, and specify both lengths in metres (--wand 0.13 0.26)."
        raise WandInvalid(message, hint=hint)


def _chained(names: Sequence[str], places: np.ndarray, pair: Pair) -> list[Pose]:
    seen = np.isfinite(places).reshape(*places.shape[:2], -1).all(-1)
    try:
        return chained(names, seen, LEAST_TOGETHER, pair)
    except CalibrationInvalid as error:
        message = error.message.replace("the target", "the wand")
        hint = f"Wave the wand where both sensors see it, for at least {LEAST_TOGETHER} frames."
        raise WandNotSeen(message, where=", ".join(names), hint=hint) from error


SENSOR_BIAS_M = 2e-3  # Error in metres that all depths of a sensor have in common, in addition to the measured scatter.
ROUNDS = 20  # Number of reweighting iterations. Chosen by hand.


def depth_scale(cameras: Cameras, at: np.ndarray, depth_m: np.ndarray) -> tuple[float, float, float]:
    """Find the scale ``s`` of a reconstruction: ``min Σ ρ((d - s z) / σ(d))`` for depths d.

    Also return its standard deviation, and the scatter of the depths in metres. ``at`` (M, 3) are marker positions in
    the unscaled world. ``depth_m`` (C, M) are the measured depths along the axes.

    Reference: Beaton and Tukey 1974 (iterative reweighting, here with Cauchy's weights).
    """
    z = np.einsum("cj,mj->cm", cameras.R[:, 2], at) + cameras.t[:, 2:]
    known = np.isfinite(depth_m) & np.isfinite(z)
    d, z = np.where(known, depth_m, 1.0), np.where(known, z, 1.0)
    sigma = SETTINGS.depth_sigma(d)
    scale = float(np.median((d / z)[known]))
    weight = np.zeros_like(d)
    for _ in range(ROUNDS):
        square = ((d - scale * z) / sigma) ** 2
        weight = known / (1.0 + square / 9.0) / sigma**2
        scale = float((weight * z * d).sum() / (weight * z * z).sum())
    left = np.where(known, d - scale * z, np.nan)
    rmse = float(1.4826 * np.nanmedian(np.abs(left)))
    shared = np.array([(weight[c] * z[c]).sum() for c in range(len(d))]) * SENSOR_BIAS_M
    alone = (weight**2 * z**2 * np.maximum(sigma, rmse) ** 2).sum()
    return scale, float(np.sqrt((shared**2).sum() + alone) / (weight * z * z).sum()), rmse


MOST_PX = 8.0  # Largest median reprojection error in pixels of a usable calibration. Chosen by hand.


def require_fit(found: Adjusted) -> None:
    """Raise ``WandInvalid`` if the median reprojection error after the adjustment exceeds ``MOST_PX``."""
    usual = float(np.nanmedian(np.linalg.norm(found.error, axis=-1)))
    if not usual < MOST_PX:
        message = f"The sensors contradict each other. The median reprojection error is {usual:.0f} px."
        hint = "Check that the clocks agree (--trigger), that the lenses were calibrated in this mode, and that only "
        hint += "one wand was visible."
        raise WandInvalid(message, where=", ".join(found.cameras.names), hint=hint)


def metric(found: Adjusted, moments: Moments, options: WandOptions) -> tuple[CalibratedCameras, float]:
    """Return the calibration in metres, and the scatter of depths (NaN if the wand's lengths give the scale)."""
    array = result_of("wand", found)
    if options.wand is not None:
        return array, float("nan")
    scale, sigma, scatter_m = depth_scale(found.cameras, found.bodies.t, moments.depth_m[:, :, 0])
    array = moved_world(array, np.eye(3), np.zeros(3), scale)
    way = np.linalg.norm(array.cameras.centres, axis=1)
    return replace(array, centre_sigma_m=np.hypot(array.centre_sigma_m, sigma * way)), scatter_m


def _held_out_errors(
    task: WandTask, found: Adjusted, moments: Moments, options: WandOptions
) -> tuple[float, np.ndarray]:
    """Return the RMS errors in held-out time ranges: reprojection in pixels, and wand lengths (3,) in metres."""
    out = held_out(moments.px.shape[1])
    if out.sum() < LEAST_TOGETHER or (~out).sum() < LEAST_TOGETHER:
        return float("nan"), np.full(3, np.nan)
    # A sensor's delay is a single number, so it may be estimated from the whole recording.
    refit = replace(task, cameras=found.cameras, delays=found.delays, find_delays=False)
    fitted, _ = adjusted(refit, moments.where(~out))
    kept = moments.where(out)
    at = triangulated(fitted.cameras, kept, found.delays)
    error = np.linalg.norm(project(fitted.cameras, at) - in_step_px(kept, found.delays), axis=-1)
    px = float(np.sqrt(np.nanmean(error**2)))
    if options.wand is None:
        return px, np.full(3, np.nan)
    return px, np.sqrt(np.nanmean((distances(at) - options.wand.distances_m) ** 2, axis=0))


FLOOR_S = 0.004  # Shift of a speed peak by perspective, in seconds.
CLIP_SIGMAS = 3.0  # Speeds are clipped at this many standard deviations. Chosen by hand.
SMOOTHING_S = 0.06  # Standard deviation in seconds of the filter that smooths the wand's path.
SLOWEST_M_S = 0.05  # Speed in m/s of a wand that counts as still.
LEAST_CORRELATION = 0.5  # Smallest correlation between two speeds that determines an offset.
MOST_MOMENTS = 900  # Maximum number of frames that are solved, spread over the recording.


def flat_of(view: WandView) -> np.ndarray:
    """Return the (F, K, 2) undistorted normalised coordinates of a view."""
    return undistort(view.lens.as_camera(), view.px[None])[0]


def coarse_clocks(views: Sequence[WandView], wand: Wand | None, reach_s: float) -> Clocks:
    """Estimate the sensors' clocks to within about a frame by correlating the wand's speed.

    The lights in each view are in the wand's order. Without depth, the lengths of ``wand`` give its distance from the
    camera. If the speeds show no clear offset, the clocks are assumed equal, and the result contains a note.
    """
    names, signals = tuple(view.name for view in views), [_speed(view, wand) for view in views]
    lags = {"reach_s": reach_s, "floor_s": FLOOR_S, "least": LEAST_CORRELATION}
    interval_s = float(np.median(np.concatenate([np.diff(view.times_s) for view in views])))
    try:
        clocks = in_step(clocks_of_signals(names, signals, "the wand's speed", **lags), 1.0 / interval_s)
        return replace(clocks, findings=tuple(item for item in clocks.findings if item != ROLLING_SHUTTER))
    except SyncUnknown as why:
        note = diagnostic("clocks_assumed", severity=Severity.NOTE, reason=why.message)
        return replace(Clocks.alike(names), findings=(note,))


def common_moments(views: Sequence[WandView], clocks: Clocks) -> Moments:
    """Interpolate all views at the first view's frame times. Keep times when at least two sensors see the wand."""
    wanted = clocks.from_video(0, views[0].times_s)
    columns = []
    for c, view in enumerate(views):
        both = np.concatenate([view.px, view.depth_or_nan[..., None]], axis=-1)
        value, rate = values_and_velocities(both, view.times_s, clocks.in_video(c, wanted))
        columns.append((value[..., :2], rate[..., :2], value[..., 2]))
    px, velocity, depth = (np.stack(part) for part in zip(*columns, strict=True))
    moments = Moments(wanted, px, velocity, depth)
    together = np.flatnonzero(moments.seen.sum(0) >= 2)
    kept = np.unique(np.linspace(0, len(together) - 1, min(MOST_MOMENTS, len(together))).astype(int))
    return moments.where(together[kept])


def _speed(view: WandView, wand: Wand | None) -> Signal:
    """Return the logarithm of the wand's smoothed speed at regular times, or 0 where it is unknown."""
    flat = flat_of(view)
    if wand is not None:
        middle = middle_from_lights(wand, flat)
    else:
        middle = np.concatenate([flat[:, 0] * view.depth_or_nan, view.depth_or_nan], axis=1)
    count = int((view.times_s[-1] - view.times_s[0]) * SPEED_RATE_HZ) + 1
    wanted = view.times_s[0] + np.arange(count) / SPEED_RATE_HZ
    located = np.isfinite(middle).all(1)
    place = smoothed(at_times(middle[located], view.times_s[located], wanted), SMOOTHING_S * SPEED_RATE_HZ)
    speed = np.linalg.norm(np.gradient(place, axis=0), axis=-1) * SPEED_RATE_HZ
    known = np.isfinite(speed)
    if known.sum() < 2:
        return Signal(np.zeros((count, 1)), SPEED_RATE_HZ, float(view.times_s[0]))
    loud = np.log(np.maximum(np.where(known, speed, SLOWEST_M_S), SLOWEST_M_S))
    loud = np.where(known, loud - loud[known].mean(), 0.0)
    spread = float(loud[known].std())
    return Signal(
        np.clip(loud, -CLIP_SIGMAS * spread, CLIP_SIGMAS * spread)[:, None], SPEED_RATE_HZ, float(view.times_s[0])
    )


MOST_CROWDED = 0.5  # Largest fraction of frames with other lights in a usable recording. Chosen by hand.
LATE_FRAMES = 0.25  # Largest delay in frames without sampling the views again. Chosen by hand.


def calibrate_by_wand(
    views: Sequence[WandView], options: WandOptions = WandOptions(), progress: Progress = silent
) -> WandCalibration:
    """Calibrate the poses of sensors from a waved wand that all of them saw.

    The clocks are either given, or estimated from the wand's speed and refined by the adjustment. The relative pose of
    two sensors comes from aligned points, or from an essential matrix and the wand's lengths. These poses are chained.
    Finally, a sparse bundle adjustment refines all poses.

    Raises:
        WandNotSeen: a sensor saw the wand in too few frames, or too rarely together with another one.
        WandAmbiguous: most frames show other lights.
        WandInvalid: the wand differs from the given description.

    Reference: thesis 5.3.2, "Spatial Alignment". Gossard et al. 2024 (three lights without depth).
    """
    names = tuple(view.name for view in views)
    _require_seen(views)
    views = [view if options.wand is None else _with_lights(view, options.wand) for view in views]
    progress("Clocks of the sensors", 0, 3)
    clocks = coarse_clocks(views, options.wand, REACH_S) if options.clocks is None else options.clocks
    of_clocks = clocks.findings
    interval_s = float(np.median(np.diff(views[0].times_s)))
    # Small given offsets are treated as image delays. For larger ones, positions are interpolated between frames.
    known = -clocks.offset_s if np.abs(clocks.offset_s).max() < LATE_FRAMES * interval_s else np.zeros(len(names))
    sampled = replace(clocks, offset_s=clocks.offset_s + known)
    moments = _moments(views, sampled, options)
    progress("Pairs of sensors", 1, 3)
    task = _task(views, moments, options, known)
    progress("All sensors at once", 2, 3)
    found, used = adjusted(task, moments)
    if task.find_delays and np.abs(found.delays).max() > LATE_FRAMES * interval_s:
        sampled = _later(sampled, found)
        moments = _moments(views, sampled, options)
        task = replace(task, cameras=found.cameras, delays=np.zeros(len(names)))
        found, used = adjusted(task, moments)
    clocks = _later(sampled, found) if task.find_delays else clocks
    require_fit(found)
    array, depth_rmse = metric(found, moments.where(used), options)
    scaled = replace(found, cameras=array.cameras)
    held_out_px, lengths = _held_out_errors(task, scaled, moments.where(used), options)
    at = triangulated(array.cameras, moments, found.delays)
    together = moments.seen.astype(int) @ moments.seen.astype(int).T
    notes = (*notes_of(moments, together, names, options), *of_clocks)
    array = replace(array, findings=findings_of(views, array, clocks, options), notes=notes)
    coverage = Coverage(names, array.cameras.image_size)
    coverage.add(moments.px.mean(axis=2), at.mean(axis=1))
    return WandCalibration(array, clocks, together, len(used), held_out_px, lengths, depth_rmse, coverage)


def _require_seen(views: Sequence[WandView]) -> None:
    for view in views:
        seen = np.isfinite(view.px).all((1, 2))
        if view.crowded > MOST_CROWDED * max(len(view), 1):
            message = f"In {view.crowded} of {len(view)} frames, more than one wand or another light was visible."
            hint = "Remove the second wand, lamps, mirrors and worn markers."
            raise WandAmbiguous(message, where=f"sensor {view.name}", hint=hint)
        if seen.sum() < LEAST_TOGETHER:
            message = f"The wand is visible in only {int(seen.sum())} of {len(view)} frames."
            hint = "Check that the infrared light is on, the exposure is fixed, and the marker is visible."
            raise WandNotSeen(message, where=f"sensor {view.name}", hint=hint)
    if len(views) < 2:
        raise WandNotSeen(
            f"{len(views)} sensors detected a wand, but two are needed.", where=", ".join(v.name for v in views)
        )


def _with_lights(view: WandView, wand: Wand) -> WandView:
    order, sure = identified(wand, flat_of(view), SIGMA_PX / float(view.lens.K[0, 0]))
    seen = np.isfinite(view.px).all((1, 2))
    if sure.sum() < (1.0 - MOST_CROWDED) * seen.sum():
        count = f"{int((seen & ~sure).sum())} of {int(seen.sum())} frames"
        message = f"In {count}, three lights do not match a wand of {wand.first_m:.3f} and {wand.second_m:.3f} m."
        hint = "Check that no second wand or lamp is visible, and that the wand does not point at the sensor."
        raise WandAmbiguous(message, where=f"sensor {view.name}", hint=hint)
    return replace(view, px=in_order(view.px, order, sure))


def _moments(views: Sequence[WandView], clocks: Clocks, options: WandOptions) -> Moments:
    moments = common_moments(views, clocks)
    if options.every_sensor:
        moments = moments.where(moments.seen.all(0))
    if (count := moments.px.shape[1]) < LEAST_TOGETHER:
        message = f"Only {count} frames show the wand to {'all' if options.every_sensor else 'two'} sensors at once."
        where = ", ".join(view.name for view in views)
        raise WandNotSeen(message, where=where, hint="Wave the wand where their views overlap.")
    return moments


def _task(views: Sequence[WandView], moments: Moments, options: WandOptions, delays: np.ndarray) -> WandTask:
    names = tuple(view.name for view in views)
    rng = np.random.default_rng(0)
    still = cameras_at(views, [(np.eye(3), np.zeros(3))] * len(views))
    flat = undistort(still, moments.px)
    if options.wand is None:
        ray = np.concatenate([flat[:, :, 0], np.ones((*flat.shape[:2], 1))], axis=-1)
        depth = moments.depth_m[:, :, 0]
        focal = still.K[:, 0, 0, None]
        sigma = np.hypot(SETTINGS.depth_sigma(depth), depth * SIGMA_PX / focal)
        poses = _poses_by_depth(names, ray * depth[..., None], sigma, rng)
        return WandTask(cameras_at(views, poses), np.zeros((1, 3)), options.clocks is None, delays)
    poses = _poses_by_lights(names, flat, float(np.median(still.K[:, 0, 0])), options.wand, rng)
    cameras = cameras_at(views, poses)
    _require_proportion(options.wand, np.nanmedian(distances(triangulated(cameras, moments, delays)), axis=0))
    return WandTask(cameras, options.wand.lights, options.clocks is None, delays)


def _later(clocks: Clocks, found: Adjusted) -> Clocks:
    """Add the estimated delays δ to the clocks. An image with the time t shows the scene at ``t + δ``."""
    count = len(found.cameras)
    variance = np.diag(found.covariance).reshape(count, CAMERA_PARAMETERS)[:, -1]
    covariance = np.zeros((count, 2, 2))
    covariance[:, 0, 0] = variance
    return replace(clocks, offset_s=clocks.offset_s - found.delays, covariance=covariance, method="the wand's movement")
