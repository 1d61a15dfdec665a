"""Train Pose-NDF (Tiwari et al. 2022)."""
