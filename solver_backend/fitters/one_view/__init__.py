"""Solve from one camera: measured quantities, and quantities that remain uncertain."""
