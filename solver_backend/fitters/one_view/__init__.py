"""Solve from one camera, and state which quantities remain uncertain."""
