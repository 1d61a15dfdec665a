"""Uses of Pose-NDF (Tiwari et al. 2022, section 4): denoising, completion, generation, interpolation, 2D keypoints."""
