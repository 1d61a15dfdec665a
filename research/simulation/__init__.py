"""Benchmark captures: recorded motion filmed by cameras and detectors that err, and what goes wrong on a set."""
