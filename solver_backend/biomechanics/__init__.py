"""Describe motions in the conventions of biomechanics: segments, angles and gait."""
