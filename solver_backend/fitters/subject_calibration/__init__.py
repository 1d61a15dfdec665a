"""Constants of a take: shape, keypoint variances, and planted feet."""
