"""Describe motions by the conventions of biomechanics: anatomical segments, joint angles and gait."""
