"""How each method finds the poses of a take, one file a recipe."""
