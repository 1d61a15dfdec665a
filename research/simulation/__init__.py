"""Make benchmark captures from recorded motion: simulated cameras and detectors with errors, and recording faults."""
