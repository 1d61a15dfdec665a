"""Describe motions as biomechanics does: anatomical segments, joint angles and gait."""
