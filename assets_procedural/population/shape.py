"""Ten shape components from population statistics: stature, girth, then the main residual variations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from assets_procedural.arrays import Array
from assets_procedural.population.anthropometry import Measures, place_measures
from assets_procedural.population.fields import RestFrame, build_fields, displace
from assets_procedural.population.statistics import MEASURES, NUM_LENGTHS, Statistics
from assets_procedural.skeleton.skinning import cotangent_laplacian

NUM_BETAS = 10
"""Shape coefficients, as many as SMPL's files commonly have."""
NEUTRAL_STATURE_M = 1.70
"""Stature of the mean shape, metres: between the means of women and men; chosen by hand."""
_MARGIN_M = 0.001
"""By how much shapes stay within the 1st and 99th percentile, metres; chosen by hand."""
_TRUNK_GIRTHS = ("chestcircumference", "waistcircumference", "buttockcircumference")


@dataclass(frozen=True)
class ShapeSpace:
    """The mean shape and its components, floor at y = 0 for the mean."""

    vertices: Array
    """(V, 3) metres."""
    joints: Array
    """(24, 3) metres."""
    vertex_dirs: Array
    """(V, 3, 10) metres per standard deviation."""
    joint_dirs: Array
    """(24, 3, 10) metres per standard deviation."""
    carried: Array
    """(P, 3) metres: points that went along."""
    carried_dirs: Array
    """(P, 3, 10) metres per standard deviation."""
    measures: Measures
    """Landmarks and tapes on this mesh."""
    explained: float
    """Share of the population's displacement variance that the ten components carry."""


def population_mean(statistics: Statistics) -> Array:
    """Return the (M,) measures of the neutral body: the mean person, lengths scaled to a stature of 1.70 m."""
    mean = statistics.mean.copy()
    mean[:NUM_LENGTHS] *= NEUTRAL_STATURE_M / mean[0]
    return mean


def build_shape_space(
    vertices: Array, faces: Array, joints: Array, statistics: Statistics, carried: Array | None = None
) -> ShapeSpace:
    """Bring a fitted body to the population's mean and span the shape space around it.

    Args:
        vertices: (V, 3) metres, floor at y = 0.
        faces: (T, 3).
        joints: (24, 3) metres.
        statistics: of the population.
        carried: (P, 3) metres, points that move with the body and do not count for its components.
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
    """Return vertices, joints and carried points of the body whose measures equal ``wanted`` (M,) metres.

    Newton steps in the fields; the carried points go along.
    """
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
    """Return the (M, n, 3) fields of all points that each change one measure by one metre and no other."""
    moved, moved_joints, moved_carried = _fields_of(vertices, joints, carried)
    inverse = np.linalg.inv(measures.jacobian(vertices, joints, moved, moved_joints))
    unit_v, unit_j, unit_c = (np.tensordot(inverse.T, field, axes=1) for field in (moved, moved_joints, moved_carried))
    return unit_v, unit_j, unit_c


def _within_population(loadings: Array, statistics: Statistics) -> Array:
    """Return the (M, 10) loadings, shortened where two deviations would leave the 1st to 99th percentile."""
    mean = population_mean(statistics)
    room = np.minimum(statistics.p99 - mean, mean - statistics.p01) - _MARGIN_M
    reach = np.max(2.0 * np.abs(loadings) / room[:, None], axis=0)
    return loadings / np.maximum(reach, 1.0)


def _driven_components(covariance: Array) -> list[Array]:
    """Return the (M,) changes per deviation of stature at fixed trunk girth and of trunk girth at fixed stature."""
    drivers = _drivers()
    shared = drivers.T @ covariance @ drivers
    effect = covariance @ drivers @ np.linalg.inv(shared)
    return [effect[:, k] * np.sqrt(shared[k, k]) for k in range(2)]


def _drivers() -> Array:
    """Return the (M, 2) sums that the first two betas drive: stature, and chest + waist + buttock girth."""
    stature = [1.0 if name == "stature" else 0.0 for name in MEASURES]
    girth = [1.0 if name in _TRUNK_GIRTHS else 0.0 for name in MEASURES]
    return np.array([stature, girth]).T


def _principal_components(covariance: Array, metric: Array, driven: Array) -> tuple[Array, float]:
    """Return the (M, 8) loadings of the largest displacements that leave stature and trunk girth alone."""
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
