"""Compute ten shape components: stature, girth and the remaining variations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.layout import JOINT
from assets_procedural.population.statistics import MEASURES, NUM_LENGTHS, Measures, Statistics, place_measures
from assets_procedural.skeleton.skinning import cotangent_laplacian

Field = Callable[[Array], Array]
Profile = Callable[[Array], Array]


@dataclass(frozen=True)
class RestFrame:
    """Rest joints (24, 3) and height, in metres, of the body to deform."""

    joints: Array
    top: float

    def at(self, name: str) -> Array:
        """Return the (3,) rest position of a joint in metres."""
        return self.joints[JOINT[name]]


def build_fields(frame: RestFrame) -> dict[str, Field]:
    """Return a displacement field for each of ``MEASURES``: a function that maps (N, 3) points to (N, 3) offsets."""
    return _length_fields(frame) | _girth_fields(frame)


def displace(fields: dict[str, Field], points: Array) -> Array:
    """Return the displacements (M, N, 3) of N points by M fields. They are exactly mirror-symmetric."""
    side = np.where(points[:, :1] < 0, np.array([[-1.0, 1.0, 1.0]]), 1.0)
    left = points * side
    moved = np.stack([field(left) for field in fields.values()])
    moved[:, points[:, 0] == 0.0, 0] = 0.0
    return moved * side


def _length_fields(frame: RestFrame) -> dict[str, Field]:
    hip, knee, ankle, wrist = (frame.at(f"left_{n}") for n in ("hip", "knee", "ankle", "wrist"))
    shoulder, elbow, neck = frame.at("left_shoulder"), frame.at("left_elbow"), frame.at("neck")

    def along_y(low: float, high: float) -> Field:
        return lambda p: np.stack([0 * p[:, 0], _ramp(p[:, 1], low, high), 0 * p[:, 0]], axis=1)

    def along_x(low: float, high: float) -> Field:
        return lambda p: np.stack([_ramp(p[:, 0], low, high) * _arm(p), 0 * p[:, 0], 0 * p[:, 0]], axis=1)

    def breadth(p: Array) -> Array:
        return np.stack([_ramp(p[:, 0], 0.03, shoulder[0]) * _step(p[:, 1], 1.14, 1.36), 0 * p[:, 0], 0 * p[:, 0]], 1)

    def hand(p: Array) -> Array:
        return _step(p[:, 0], wrist[0] - 0.03, wrist[0] + 0.03)[:, None] * (p - wrist)

    def foot(p: Array) -> Array:
        moved = (p - ankle) * [1.0, 0.0, 1.0]
        return (1.0 - _step(p[:, 1], 0.035, 0.110))[:, None] * moved

    return {
        "stature": along_y(neck[1] - 0.01, frame.top - 0.02),
        "cervicaleheight": along_y(hip[1] + 0.03, 1.29),
        "crotchheight": along_y(knee[1] + 0.03, hip[1] - 0.12),
        "kneeheightmidpatella": along_y(ankle[1] + 0.03, knee[1] - 0.03),
        "span": along_x(shoulder[0] + 0.04, elbow[0] - 0.02),
        "biacromialbreadth": breadth,
        "radialestylionlength": along_x(elbow[0] + 0.02, wrist[0] - 0.02),
        "handlength": hand,
        "footlength": foot,
    }


def _girth_fields(frame: RestFrame) -> dict[str, Field]:
    at = frame.at
    spine = np.stack([at(n) for n in ("pelvis", "spine1", "spine2", "spine3", "neck", "head")])
    hip, knee, ankle = at("left_hip"), at("left_knee"), at("left_ankle")
    shoulder, elbow, wrist = at("left_shoulder"), at("left_elbow"), at("left_wrist")

    def trunk(profile: Profile, inside: Field) -> Field:
        def field(p: Array) -> Array:
            z = np.interp(p[:, 1], spine[:, 1], spine[:, 2])
            share = profile(p[:, 1]) * inside(p)
            return share[:, None] * np.stack([p[:, 0], 0 * z, p[:, 2] - z], axis=1)

        return field

    def leg(start: Array, end: Array, profile: Profile) -> Field:
        def field(p: Array) -> Array:
            t = (p[:, 1] - start[1]) / (end[1] - start[1])
            out = (p - (start + t[:, None] * (end - start))) * [1.0, 0.0, 1.0]
            out[:, 0] += 0.055 * _step(p[:, 1], knee[1] - 0.1, knee[1] + 0.25)  # keeps the thighs apart
            return profile(p[:, 1])[:, None] * out

        return field

    def arm(start: Array, end: Array, profile: Profile) -> Field:
        def field(p: Array) -> Array:
            t = np.clip((p[:, 0] - start[0]) / (end[0] - start[0]), -0.5, 1.5)
            out = (p - (start + t[:, None] * (end - start))) * [0.0, 1.0, 1.0]
            return (profile(p[:, 0]) * _arm(p))[:, None] * out

        return field

    def not_arm(p: Array) -> Array:
        return 1.0 - _step(p[:, 0], 0.12, 0.22) * _step(p[:, 1], 1.17, 1.36)

    def near_axis(p: Array) -> Array:
        return 1.0 - _step(p[:, 0], 0.07, 0.12)

    def head(p: Array) -> Array:
        centre = at("head") * [1.0, 0.0, 1.0]
        return _step(p[:, 1], at("neck")[1] + 0.01, at("head")[1] + 0.06)[:, None] * (p * [1.0, 0.0, 1.0] - centre)

    return {
        "headcircumference": head,
        "neckcircumference": trunk(_profile({1.40: 0, 1.455: 1, 1.515: 0}), near_axis),
        "chestcircumference": trunk(_profile({1.045: 0, 1.265: 1, 1.41: 0}), not_arm),
        "waistcircumference": trunk(_profile({0.885: 0, 1.045: 1, 1.265: 0}), not_arm),
        "buttockcircumference": trunk(_profile({0.70: 0, 0.885: 1, 1.045: 0}), lambda p: np.ones(len(p))),
        "thighcircumference": leg(hip, knee, _profile({0.35: 0, 0.48: 0.4, 0.70: 1, 0.885: 0})),
        "calfcircumference": leg(knee, ankle, _profile({0.125: 0, 0.35: 1, 0.48: 0.4, 0.70: 0})),
        "anklecircumference": leg(knee, ankle, _profile({0.02: 0, 0.11: 1, 0.35: 0})),
        "bicepscircumferenceflexed": arm(shoulder, elbow, _profile({0.15: 0, 0.29: 1, 0.44: 0.45, 0.505: 0})),
        "forearmcircumferenceflexed": arm(elbow, wrist, _profile({0.29: 0, 0.44: 0.45, 0.505: 1, 0.65: 0})),
        "wristcircumference": arm(elbow, wrist, _profile({0.505: 0, 0.65: 1, 0.73: 0})),
    }


def _profile(knots: dict[float, float]) -> Profile:
    at, values = list(knots), list(knots.values())

    def curve(x: Array) -> Array:
        out = np.full_like(x, values[0])
        for low, high, before, after in zip(at, at[1:], values, values[1:], strict=False):
            out = out + (after - before) * _step(x, low, high)
        return out

    return curve


def _arm(p: Array) -> Array:
    return _step(p[:, 0], 0.13, 0.21) * _step(p[:, 1], 1.10, 1.24)


def _step(x: Array, low: float, high: float) -> Array:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * t * (t * (6.0 * t - 15.0) + 10.0)


def _ramp(x: Array, low: float, high: float) -> Array:
    """Return 0 below ``low``, 1 above ``high``, and a line with rounded ends between them."""
    soft = 0.08 * (high - low)

    def bend(y: Array) -> Array:
        return soft * np.logaddexp(0.0, y / soft)

    return (bend(x - low) - bend(x - high)) / (high - low)


NUM_BETAS = 10  # Number of shape coefficients, as in most SMPL files.
NEUTRAL_STATURE_M = 1.70  # Stature of the mean shape in metres, between the means of women and men. Chosen by hand.
_MARGIN_M = 0.001  # Distance in metres that shapes keep from the 1st and 99th percentiles. Chosen by hand.
_TRUNK_GIRTHS = ("chestcircumference", "waistcircumference", "buttockcircumference")


@dataclass(frozen=True)
class ShapeSpace:
    """Mean shape with the floor at y = 0, and components in metres per standard deviation."""

    vertices: Array
    joints: Array
    vertex_dirs: Array  # (V, 3, 10) metres per unit of shape.
    joint_dirs: Array  # (24, 3, 10) metres per unit of shape.
    carried: Array  # (P, 3) additional points that follow the mesh, in metres.
    carried_dirs: Array  # (P, 3, 10) metres per unit of shape.
    measures: Measures  # Landmarks and girth lines for this mesh.
    explained: float  # Fraction of the population's displacement variance that the ten components explain.


def population_mean(statistics: Statistics) -> Array:
    """Return the measures (M,) of the mean person. Lengths are scaled to a stature of 1.70 m."""
    mean = statistics.mean.copy()
    mean[:NUM_LENGTHS] *= NEUTRAL_STATURE_M / mean[0]
    return mean


def build_shape_space(
    vertices: Array, faces: Array, joints: Array, statistics: Statistics, carried: Array | None = None
) -> ShapeSpace:
    """Deform a fitted body (floor at y = 0) to the population mean, and compute its shape space.

    ``carried`` (P, 3) are points that move with the body but do not affect its components.
    """
    carried = np.zeros((0, 3)) if carried is None else carried
    vertices, joints, carried = calibrate(vertices, faces, joints, population_mean(statistics), carried)
    measures = place_measures(vertices, faces, joints)
    unit_v, unit_j, unit_c = _unit_fields(vertices, joints, carried, measures)
    loadings = np.stack(_driven_components(statistics.covariance), axis=1)
    _, area = cotangent_laplacian(vertices, faces)
    metric = np.einsum("iva,jva,v->ij", unit_v, unit_v, area / area.sum(), optimize=True)
    rest, explained = _principal_components(statistics.covariance, metric, loadings)
    loadings = _within_population(np.concatenate([loadings, rest], axis=1), statistics)
    vertex_dirs = np.einsum("iva,ik->vak", unit_v, loadings)
    joint_dirs = np.einsum("ija,ik->jak", unit_j, loadings)
    carried_dirs = np.einsum("ipa,ik->pak", unit_c, loadings)
    pelvis = joint_dirs[0].copy()
    pelvis[0] = 0.0
    dirs = (vertex_dirs - pelvis, joint_dirs - pelvis)
    return ShapeSpace(vertices, joints, *dirs, carried, carried_dirs - pelvis, measures, explained)


def calibrate(
    vertices: Array, faces: Array, joints: Array, wanted: Array, carried: Array, rounds: int = 6
) -> tuple[Array, Array, Array]:
    """Deform a body by Newton steps to the measures ``wanted`` (M,). Return vertices, joints and carried points."""
    for _ in range(rounds):
        measures = place_measures(vertices, faces, joints)
        moved, moved_joints, moved_carried = _fields_of(vertices, joints, carried)
        jacobian = measures.jacobian(vertices, joints, moved, moved_joints)
        step = np.linalg.solve(jacobian, wanted - measures(vertices, joints))
        vertices = vertices + np.tensordot(step, moved, axes=1)
        joints = joints + np.tensordot(step, moved_joints, axes=1)
        carried = carried + np.tensordot(step, moved_carried, axes=1)
        floor = vertices[:, 1].min()
        for points in (vertices, joints, carried):
            points[:, 1] -= floor
    return vertices, joints, carried


def _fields_of(vertices: Array, joints: Array, carried: Array) -> tuple[Array, Array, Array]:
    fields = build_fields(RestFrame(joints, float(vertices[:, 1].max())))
    fields = {name: fields[name] for name in MEASURES}
    moved = displace(fields, np.concatenate([vertices, joints, carried]))
    of_vertices, of_joints, of_carried = np.split(moved, np.cumsum([len(vertices), len(joints)]), axis=1)
    return of_vertices, of_joints, of_carried


def _unit_fields(vertices: Array, joints: Array, carried: Array, measures: Measures) -> tuple[Array, Array, Array]:
    """Return fields (M, n, 3) for n vertices, joints and carried points. Each changes only one measure, by 1 m."""
    moved, moved_joints, moved_carried = _fields_of(vertices, joints, carried)
    inverse = np.linalg.inv(measures.jacobian(vertices, joints, moved, moved_joints))
    unit_v, unit_j, unit_c = (np.tensordot(inverse.T, field, axes=1) for field in (moved, moved_joints, moved_carried))
    return unit_v, unit_j, unit_c


def _within_population(loadings: Array, statistics: Statistics) -> Array:
    """Shrink components (M, 10) so that ±2 standard deviations keep all measures in the 1st to 99th percentile."""
    mean = population_mean(statistics)
    room = np.minimum(statistics.p99 - mean, mean - statistics.p01) - _MARGIN_M
    reach = np.max(2.0 * np.abs(loadings) / room[:, None], axis=0)
    return loadings / np.maximum(reach, 1.0)


def _driven_components(covariance: Array) -> list[Array]:
    """Return the change of the measures (M,) per standard deviation of stature, and of trunk girth."""
    drivers = _drivers()
    shared = drivers.T @ covariance @ drivers
    effect = covariance @ drivers @ np.linalg.inv(shared)
    return [effect[:, k] * np.sqrt(shared[k, k]) for k in range(2)]


def _drivers() -> Array:
    """Return weights (M, 2) of the measures that the first two betas drive: stature, and chest + waist + buttocks."""
    stature = [1.0 if name == "stature" else 0.0 for name in MEASURES]
    girth = [1.0 if name in _TRUNK_GIRTHS else 0.0 for name in MEASURES]
    return np.array([stature, girth]).T


def _principal_components(covariance: Array, metric: Array, driven: Array) -> tuple[Array, float]:
    """Return the largest components (M, 8) that leave stature and trunk girth unchanged.

    Also return the fraction of the variance that these and the two driven components explain.
    """
    drivers = _drivers()
    crossed = covariance @ drivers
    residual = covariance - crossed @ np.linalg.solve(drivers.T @ crossed, crossed.T)
    root = np.linalg.cholesky(metric + 1e-12 * np.trace(metric) * np.eye(len(metric)))
    variance, directions = np.linalg.eigh(root.T @ residual @ root)
    order = np.argsort(-variance, kind="stable")[: NUM_BETAS - driven.shape[1]]
    loadings = np.linalg.solve(root.T, directions[:, order]) * np.sqrt(variance[order].clip(0.0))
    signs = np.sign(loadings[np.abs(loadings).argmax(axis=0), np.arange(len(order))])
    total = float(np.sum(metric * covariance))
    kept = total - float(variance.clip(0.0).sum() - variance[order].clip(0.0).sum())
    return loadings * signs, kept / total
