"""What stays the same over a take: shape, keypoint variances, where feet stand."""
