"""Fit the Gaussian mixture of poses."""
