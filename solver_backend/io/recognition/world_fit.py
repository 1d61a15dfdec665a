"""Fit up axis, scale, level and floor of a calibration's world to the person."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from solver_backend.agreement.person_selection import SelectedPerson
from solver_backend.cameras.camera_corrections import unrolled
from solver_backend.cameras.projection import project
from solver_backend.cameras.robust_triangulation import triangulate
from solver_backend.exchange.diagnostics import Diagnostic, Severity, diagnostic
from solver_backend.exchange.errors import JobInvalid, NoDetections
from solver_backend.exchange.reading_settings import AUTO, OFF, WorldSettings
from solver_backend.geometry.arrays import quantile
from solver_backend.io.recognition.gravity import CONTRADICTS, OFF_FLOOR_M, Level, measure_level, roll_gain
from solver_backend.io.recognition.marker_up_axis import rotation_to_z_up, with_up_axis
from solver_backend.io.recognition.one_camera import fit_one_camera
from solver_backend.io.recognition.person_scale import LEG_SHARE, scale_from_stature
from solver_backend.types import Cameras, Keypoints2D

SAMPLED_FRAMES = 100
PLAUSIBLE_STATURE_M = (1.0, 2.3)
LIMB_RATIOS = (0.65, 1.55)
"""Upper arm over forearm and thigh over shank: people have 1.05 and 0.96 between joints (de Leva 1996), detections of
the demo and of four recorded takes 0.95 to 1.19."""
BENDS = 1.5
"""Times the spread of the upper half's length by which the distance of a limb's ends spreads if it bends there."""
_LIMBS = tuple(
    (f"{side} {limb}", *[f"{side}_{part}" for part in parts])
    for side in ("left", "right")
    for limb, parts in (("arm", ("shoulder", "elbow", "wrist")), ("leg", ("hip", "knee", "ankle")))
)
FLOOR_TOLERANCE_M = 0.25
LEAST_UPRIGHT = 0.9
"""Least cosine of a standing person's angle to an axis."""
LARGEST_RESIDUAL_PX = 40.0
LARGEST_BIAS_PX = 15.0
FAR_OFF_PX = 100.0
"""Least shift of a camera that refining cannot correct."""
BIAS_FRAMES, BIAS_CAMERAS = 40, 24  # Frames in which each camera is compared with the others. Fewer with more cameras.
_CODES = frozenset(
    {
        "person_triangulated",
        "stature_unlikely",
        "limb_halves_odd",
        "person_along_axis",
        "floor_off",
        "views_disagree",
        "cameras_shifted",
        "cameras_elsewhere",
        "nothing_located",
    }
)
"""Diagnostics of a check of the world. Another check replaces them."""
_UNITS = {10.0: "mm instead of cm", 0.1: "cm instead of mm", 1000.0: "m instead of mm", 0.001: "mm instead of m"}
"""Mistaken units, by the factor that gives a person's size."""


def without_world(found: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """Return the diagnostics without those of an earlier check of the world."""
    return tuple(item for item in found if item.code not in _CODES)


@dataclass(frozen=True)
class WorldCheck:
    """Figures of the triangulated person. NaN where they cannot be measured."""

    stature_m: float
    """From the lengths of thigh and shank."""
    height_m: float
    """95th percentile of the height of the highest over the lowest keypoint."""
    lowest_m: float
    """5th percentile over the frames of the height of the lowest keypoint."""
    upright: tuple[float, float, float]
    """Median direction from ankles to shoulders, in world axes."""
    residual_px: float
    """Median reprojection error."""
    points: np.ndarray
    """(F, K, 3) keypoints of the sampled frames, metres."""
    fps: float
    """Sampled frames per second."""
    off_px: dict[str, float]
    """Length of the median shift of each camera's keypoints against the other cameras."""
    limbs: Mapping[str, float] = field(default_factory=dict)
    """Length ratio of the halves of each arm and leg, unless the limb surely bends at its middle."""

    def notes(self) -> tuple[Diagnostic, ...]:
        """Return the figures."""
        if not np.isfinite(self.stature_m):
            return ()
        return (
            diagnostic(
                "person_triangulated", stature=self.stature_m, span=self.height_m, lowest=self.lowest_m,
                size=self.residual_px,
            ),
        )  # fmt: skip

    def problems(self) -> tuple[Diagnostic, ...]:
        """Return each figure that is implausible."""
        found: list[Diagnostic] = []
        low, high = PLAUSIBLE_STATURE_M
        if np.isfinite(self.stature_m) and not low < self.stature_m < high:
            units = [words for factor, words in _UNITS.items() if 1.3 < self.stature_m * factor < 2.1]
            reason = f"may have been read as {units[0]}" if units else "may have a wrong unit"
            found.append(diagnostic("stature_unlikely", stature=self.stature_m, reason=reason))
        else:
            found += self._placement()
        least, most = LIMB_RATIOS
        found += [
            diagnostic(
                "limb_halves_odd", limb=limb, ratio=ratio, middle=middle.replace("_", " "), end=end.replace("_", " ")
            )
            for (limb, _, middle, end) in _LIMBS
            if np.isfinite(ratio := self.limbs.get(limb, np.nan)) and not least < ratio < most
        ]
        found += disagreement(self.residual_px)
        wrong = {name: off for name, off in self.off_px.items() if off > LARGEST_BIAS_PX}
        far = {name: off for name, off in wrong.items() if off > FAR_OFF_PX}
        near = {name: off for name, off in wrong.items() if name not in far}
        for code, some in (("cameras_shifted", near), ("cameras_elsewhere", far)):
            if some and self.residual_px <= LARGEST_RESIDUAL_PX:
                found.append(diagnostic(code, cameras=list(some), shifts={n: round(off) for n, off in some.items()}))
        return tuple(found)

    def up_axis(self) -> str:
        """Return the axis along the standing person, such as '-y', or 'z' if it is not clear."""
        axis = int(np.argmax(np.abs(np.nan_to_num(self.upright))))
        value = self.upright[axis]
        low, high = PLAUSIBLE_STATURE_M
        clear = abs(value) > LEAST_UPRIGHT and low < self.stature_m < high
        return ("-" if value < 0 else "") + "xyz"[axis] if clear else "z"

    def _placement(self) -> list[Diagnostic]:
        name = self.up_axis().upper()
        if name != "Z":
            return [diagnostic("person_along_axis", axis=name)]
        if np.isfinite(self.lowest_m) and abs(self.lowest_m) > FLOOR_TOLERANCE_M and self.upright[2] > LEAST_UPRIGHT:
            return [diagnostic("floor_off", lowest=self.lowest_m)]
        return []


def disagreement(residual_px: float) -> tuple[Diagnostic, ...]:
    """Report a median residual of views that do not match."""
    return (diagnostic("views_disagree", size=residual_px),) if residual_px > LARGEST_RESIDUAL_PX else ()


def nothing_checked(keypoints: Keypoints2D) -> WorldCheck:
    """Return the unknown figures of a person in a single view."""
    nowhere, unknown = np.full((keypoints.num_frames, keypoints.xy.shape[2], 3), np.nan), float("nan")
    return WorldCheck(unknown, unknown, unknown, (unknown, unknown, unknown), unknown, nowhere, keypoints.fps, {})


def check_world(cameras: Cameras, keypoints: Keypoints2D) -> WorldCheck:
    """Return figures of the person, triangulated in up to ``SAMPLED_FRAMES`` frames.

    Args:
        cameras: C cameras.
        keypoints: detections of one person.
    """
    frames = np.unique(np.linspace(0, keypoints.num_frames - 1, SAMPLED_FRAMES).round().astype(int))
    xy, confidence = keypoints.xy[:, frames], keypoints.confidence[:, frames]
    most = max(4, min(BIAS_FRAMES, int(BIAS_FRAMES * (BIAS_CAMERAS / max(len(cameras), 1)) ** 2)))
    few = slice(None, None, len(frames) // most + 1)
    found = triangulate(cameras, xy, confidence)
    points = np.asarray(found.points)
    named = {name: points[:, k] for k, name in enumerate(keypoints.joint_set.keypoints)}
    residual = np.asarray(found.residual_px)
    z = points[..., 2]
    some = np.isfinite(z).sum(axis=1) >= 8
    lowest = np.min(np.where(np.isfinite(z[some]), z[some], np.inf), axis=1)
    highest = np.max(np.where(np.isfinite(z[some]), z[some], -np.inf), axis=1)
    return WorldCheck(
        stature_m=_legs(named) / LEG_SHARE,
        height_m=float(quantile(highest - lowest, 0.95, axis=0)),
        lowest_m=float(quantile(lowest, 0.05, axis=0)),
        upright=_is_upright(named),
        residual_px=float(quantile(residual.ravel(), 0.5, axis=0)),
        points=points,
        fps=keypoints.fps * len(frames) / keypoints.num_frames,
        limbs={limb: _half_ratio(named, *parts) for limb, *parts in _LIMBS},
        off_px=dict(_biases(cameras, xy[:, few], confidence[:, few], np.asarray(found.sigma_px))),
    )


def _biases(
    cameras: Cameras, xy: np.ndarray, confidence: np.ndarray, sigma_px: np.ndarray
) -> Iterator[tuple[str, float]]:
    """Yield name and shift in pixels of each of three or more cameras against the others."""
    everyone = list(range(len(cameras)))
    for c in everyone if len(cameras) > 2 else []:
        others = [i for i in everyone if i != c]
        points = np.asarray(triangulate(cameras.subset(others), xy[others], confidence[others], sigma_px).points)
        own = cameras.subset([c])
        expected = project(own, points)[0]
        shift = (xy[c] - expected)[np.isfinite(xy[c] - expected).all(-1)]
        if len(shift):
            yield cameras.names[c], float(np.linalg.norm(np.median(shift, axis=0)))


def _half_ratio(named: dict[str, np.ndarray], upper: str, middle: str, end: str) -> float:
    """Return the ratio of a limb's upper to its lower half, NaN if it is unseen or surely bends at its middle.

    A limb that bends at its middle changes the distance of its ends, whatever a detector takes for its joints.
    """
    if not {upper, middle, end} <= named.keys():
        return float("nan")
    pairs = (upper, middle), (middle, end), (upper, end)
    lengths = [np.linalg.norm(named[a] - named[b], axis=-1) for a, b in pairs]
    low, usual, high = (np.array([float(quantile(length, q, axis=0)) for length in lengths]) for q in (0.1, 0.5, 0.9))
    bends = (high - low)[2] > BENDS * (high - low)[0]
    return float("nan") if bends else float(usual[0] / usual[1])


def _legs(named: dict[str, np.ndarray]) -> float:
    """Return the median length of thigh and shank of both sides in metres."""
    total = 0.0
    for upper, lower in (("hip", "knee"), ("knee", "ankle")):
        lengths = [np.linalg.norm(named[f"{s}_{upper}"] - named[f"{s}_{lower}"], axis=-1) for s in ("left", "right")]
        both = np.concatenate(lengths)
        total += float(quantile(both.ravel(), 0.5, axis=0))
    return total


def _is_upright(named: dict[str, np.ndarray]) -> tuple[float, float, float]:
    up = sum(named[f"{s}_shoulder"] - named[f"{s}_ankle"] for s in ("left", "right"))
    direction = np.asarray(up) / np.maximum(np.linalg.norm(up, axis=-1, keepdims=True), 1e-9)
    known = direction[np.isfinite(direction).all(-1)]
    x, y, z = np.median(known, axis=0).tolist() if len(known) else (np.nan, np.nan, np.nan)
    return x, y, z


SURELY_UPRIGHT = np.cos(np.radians(6.0))
"""Cosine of a person's angle with Z that needs no closer look if the floor is under the feet."""
SAME_SCALE = 0.2  # Logarithm of a scale that does not change the found people.
OTHER_STATURE, STATURE_SIGMAS = 0.06, 3.0
"""Logarithm of a scale, and its standard deviations, beyond which a given stature contradicts a calibration with a
possible person. A badly measured board stays within them."""


@dataclass(frozen=True)
class WorldFit:
    """Cameras in a fitting world, the person in it, and the changes."""

    cameras: Cameras
    check: WorldCheck
    notes: tuple[Diagnostic, ...] = ()
    """Changes that the settings asked for."""
    problems: tuple[Diagnostic, ...] = ()
    """Changes that nobody asked for."""
    from_person: bool = False
    """Up and floor of a single camera's world are the person's."""


def scale_world(
    cameras: Cameras, keypoints: Keypoints2D, settings: WorldSettings
) -> tuple[Cameras, tuple[Diagnostic, ...]]:
    """Return the cameras in the requested scale, with notes and warnings about it.

    A world ``s`` times as large leaves every picture as it is: ``x_cam = R x + t`` becomes ``R x + s t``.

    Args:
        cameras: C cameras.
        keypoints: detections of the person whose stature is known.
        settings: hold the stature or the scale.

    Raises:
        JobInvalid: both are given, the stature is impossible, or too little of the person is seen.
    """
    if settings.stature and len(cameras) > 1 and settings.scale != 1.0:
        raise JobInvalid("Stature and scale both set the size of the world.", hint="Give one of them.")
    if (not settings.stature or len(cameras) < 2) and settings.scale == 1.0:
        return cameras, ()
    if not settings.stature or len(cameras) < 2:  # what one camera sees has no scale of its own
        note = diagnostic("world_scaled", reason="scale", scale=settings.scale)
        return replace(cameras, t=cameras.t * settings.scale), (note,)
    scale, share = scale_from_stature(check_world(cameras, keypoints).points, keypoints.joint_set, settings.stature)
    found = [diagnostic("world_scaled", reason="stature", scale=scale, percent=100 * share, stature=settings.stature)]
    calibrated = settings.stature / scale
    contradicts = abs(np.log(scale)) > max(OTHER_STATURE, STATURE_SIGMAS * share)
    if contradicts and PLAUSIBLE_STATURE_M[0] < calibrated < PLAUSIBLE_STATURE_M[1]:
        found.append(diagnostic("stature_contradicts", size=calibrated, stature=settings.stature, scale=scale))
    return replace(cameras, t=cameras.t * scale), tuple(found)


def find_people(
    cameras: Cameras,
    select: Callable[[Cameras], tuple[SelectedPerson, ...]],
    settings: WorldSettings,
    to_plausible: float = 1.0,
) -> tuple[Cameras, tuple[SelectedPerson, ...], tuple[Diagnostic, ...]]:
    """Return the cameras in the requested scale, their people, and notes.

    People are matched in metres, so they are found again after a change of the scale.

    Args:
        cameras: as calibrated.
        select: finds people, the main one first.
        settings: see ``scale_world``.
        to_plausible: factor on the cameras' lengths by which a person has a possible size, see ``unit_by_person``.

    Raises:
        JobInvalid: see ``scale_world``.
    """
    plausible = replace(cameras, t=cameras.t * to_plausible) if to_plausible != 1.0 else cameras
    people = select(plausible)
    scaled, notes = scale_world(cameras, people[0].keypoints, settings)
    size = [float(np.abs(c.t).max()) + 1e-9 for c in (plausible, scaled)]
    again = bool(notes) and abs(np.log(size[1] / size[0])) > SAME_SCALE
    return scaled, select(scaled) if again else people, notes


def fit_world(
    cameras: Cameras,
    keypoints: Keypoints2D,
    settings: WorldSettings = WorldSettings(),
    up_axis: str | None = None,
    rolls: Sequence[int] = (),
) -> WorldFit:
    """Return cameras in a world with an upright person.

    A calibration without a floor has the axes of a camera, with y down, or of a board.

    Args:
        cameras: C cameras, in metres.
        keypoints: detections of one person.
        settings: whether the world is levelled.
        up_axis: the user's up axis, which stays the nearest one.
        rolls: quarter turns of the recorded pictures against the calibrated ones. Either may be upright.

    Raises:
        NoDetections: the world was to be levelled, and nobody stands in it.
    """
    if len(cameras) == 1:
        one = fit_one_camera(cameras, keypoints, settings)
        return WorldFit(one.camera, nothing_checked(keypoints), one.notes, one.problems, one.from_person)
    world = check_world(cameras, keypoints)
    axis, problems = world.up_axis(), ()
    if up_axis is None and axis != "z" and settings.level != OFF and not _lies(cameras, axis, rolls):
        cameras, problems = with_up_axis(cameras, axis), (diagnostic("up_by_person", basis="axis", axis=axis.upper()),)
        world = check_world(cameras, keypoints)
    levelled, found = _level(cameras, keypoints, world, settings.level, rolls)
    if levelled is not cameras:
        world = check_world(levelled, keypoints)
    if settings.level == AUTO:
        return WorldFit(levelled, world, problems=(*problems, *found))
    return WorldFit(levelled, world, found, problems)


def _level(
    cameras: Cameras, keypoints: Keypoints2D, world: WorldCheck, how: str, rolls: Sequence[int]
) -> tuple[Cameras, tuple[Diagnostic, ...]]:
    """Return the cameras in a level world, and the changes."""
    fits = world.upright[2] > SURELY_UPRIGHT and abs(world.lowest_m) < OFF_FLOOR_M
    if how == OFF or (how == AUTO and fits):
        return cameras, ()
    try:
        level = measure_level(world.points, keypoints.joint_set, _upright(cameras, rolls, world.upright), world.fps)
    except NoDetections:
        if how == AUTO:
            return cameras, ()
        raise
    if level.is_tilted or how != AUTO:
        return _moved(cameras, level.turn, level.floor_upright_m), (_levelled(level, how),)
    if level.is_above_feet:
        found = diagnostic("floor_by_feet", depth=-level.floor_m)
        return _moved(cameras, np.eye(3), level.floor_m), (found,)
    return cameras, ()


def _lies(cameras: Cameras, axis: str, rolls: Sequence[int]) -> bool:
    """Return whether a person along an axis lies, because the cameras are level in the present world."""
    up = rotation_to_z_up(axis).T[:, 2]
    return roll_gain(_upright(cameras, rolls, up).R, up) <= -CONTRADICTS


def _upright(cameras: Cameras, rolls: Sequence[int], up: Sequence[float] | np.ndarray) -> Cameras:
    """Return the cameras with the roll of their pictures as recorded or as calibrated, whichever fits an up better."""
    if not any(rolls) or not np.isfinite(up).all():
        return cameras
    calibrated = replace(cameras, R=unrolled(cameras.R, rolls))
    return max((cameras, calibrated), key=lambda found: roll_gain(found.R, np.asarray(up)))


def _moved(cameras: Cameras, turn: np.ndarray, floor_m: float) -> Cameras:
    """Return cameras in the world ``x' = turn x - (0, 0, floor)``: ``R' = R turnᵀ``, ``t' = t + R' (0, 0, floor)``."""
    R = cameras.R @ turn.T
    return replace(cameras, R=R, t=cameras.t + floor_m * R[..., 2])


def _levelled(level: Level, how: str) -> Diagnostic:
    figures = {
        "tilt": np.degrees(level.tilt), "sigma": np.degrees(level.sigma), "floor": level.floor_upright_m,
    }  # fmt: skip
    if how != AUTO:
        return diagnostic("world_levelled", reason="asked", severity=Severity.NOTE, **figures)
    shown = (("the balance", level.balance), ("the floor under the feet", level.floor), ("the cameras", level.cameras))
    witnesses = " and ".join(name for name, gain in shown if gain > 0)
    return diagnostic("world_levelled", reason="shown", witnesses=witnesses, **figures)
