"""Transfer motions from other skeletons to the product's body."""
