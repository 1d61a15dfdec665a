"""Solves compared with the truth, and what a rig would reach before it is bought."""
