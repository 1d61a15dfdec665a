"""Write motions as actions with curves, sparse keys and confidence. Convert poses back to the solver's parameters."""
