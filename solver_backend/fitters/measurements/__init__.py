"""Prepare the input of a fit: points, their covariance and a data term."""
