"""Pose-NDF: the distance to plausible poses as a neural field (Tiwari et al. 2022)."""
