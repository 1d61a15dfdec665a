"""Measures of a solve; every name states its unit, every docstring its alignment. Missing points (NaN) take no part."""

from solver_backend.metrics.angles import angle_mae_deg, geodesic_deg
from solver_backend.metrics.generation import diversity, frechet_distance
from solver_backend.metrics.image import reprojection_px
from solver_backend.metrics.positions import distances_m, mpjpe_mm, pa_mpjpe_mm, pck_percent, rmse_mm
from solver_backend.metrics.self_intersection import self_intersection_m, self_intersection_percent
from solver_backend.metrics.smoothness import accel_error_m_s2, accelerations_m_s2, foot_skating_cm_per_frame

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
]
