"""How each method finds the poses of a take, one file a recipe; ``fitters/methods.py`` lists them."""
