"""Benchmark captures: recorded motion filmed by cameras and detectors with errors, and what goes wrong on a set."""
