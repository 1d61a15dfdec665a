"""Solve from one camera: measured quantities, and the ones that remain uncertain."""
