"""Describe motions as in biomechanics: anatomical segments, joint angles, gait."""
