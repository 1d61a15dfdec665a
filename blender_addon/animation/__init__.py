"""Write motions as actions with curves, sparse keys and confidence."""
