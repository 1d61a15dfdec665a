"""Transfer motions of other skeletons to our body."""
