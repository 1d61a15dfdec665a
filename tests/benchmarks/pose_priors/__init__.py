"""Figures and pictures of pose priors, and fits that use priors alone."""
