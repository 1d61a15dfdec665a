"""Training of the pose priors; the only part that needs torch."""
