"""Transfer motions of other skeletons to the product's body."""
