"""Compare solves with the ground truth, and predict the errors of a camera array."""
