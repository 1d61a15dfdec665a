"""Use Pose-NDF to denoise, complete, generate and interpolate poses (Tiwari et al. 2022)."""
