"""Make benchmark captures from recorded motion with simulated cameras, detectors and faults."""
