"""Fingers that move, for the body that is there: joints, weights, knuckle correctives and size."""
