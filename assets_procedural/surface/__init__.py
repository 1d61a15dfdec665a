"""The implicit surface: Gaussians of the left half body and their mirror images."""
