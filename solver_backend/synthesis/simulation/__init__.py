"""Benchmark captures: recorded motion filmed by simulated cameras and detectors that err; not part of the extension."""
