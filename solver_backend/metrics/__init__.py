"""Measure the errors of a solve. Missing points (NaN) are ignored."""

from solver_backend.metrics.positions import (
    accel_error_m_s2,
    accelerations_m_s2,
    angle_mae_deg,
    distances_m,
    diversity,
    foot_skating_cm_per_frame,
    frechet_distance,
    geodesic_deg,
    mpjpe_mm,
    pa_mpjpe_mm,
    pck_percent,
    reprojection_px,
    rmse_mm,
    world_mpjpe_mm,
)
from solver_backend.metrics.self_intersection import self_intersection_m, self_intersection_percent

__all__ = [
    "accel_error_m_s2",
    "accelerations_m_s2",
    "angle_mae_deg",
    "distances_m",
    "diversity",
    "foot_skating_cm_per_frame",
    "frechet_distance",
    "geodesic_deg",
    "mpjpe_mm",
    "pa_mpjpe_mm",
    "pck_percent",
    "reprojection_px",
    "rmse_mm",
    "self_intersection_m",
    "self_intersection_percent",
    "world_mpjpe_mm",
]
