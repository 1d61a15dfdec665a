"""Motion as actions: curves, few keys, takes."""
