"""Motions as biomechanics describes them: anatomical segments, joint angles, gait."""
