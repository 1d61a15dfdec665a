"""Write motions as actions: curves, few keys, confidence and takes. Convert poses back to the solver's parameters."""
