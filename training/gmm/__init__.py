"""Fitting the Gaussian mixture of poses."""
