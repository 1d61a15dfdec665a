"""Solves compared with the truth, and what an array would reach before it is bought."""
