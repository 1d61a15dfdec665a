"""Solve from one camera, and report which quantities remain uncertain."""
