"""Transfer motions from other skeletons to our body."""
