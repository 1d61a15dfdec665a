"""Fit the Gaussian mixture prior of poses."""
