"""Describe motions by the conventions of biomechanics: segments, angles and gait."""
