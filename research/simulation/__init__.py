"""Benchmark captures: recorded motion, simulated cameras and detectors with errors, and recording faults."""
