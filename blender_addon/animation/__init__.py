"""Motion as actions: curves, few keys, confidence, takes, and a pose back to the solver's parameters."""
