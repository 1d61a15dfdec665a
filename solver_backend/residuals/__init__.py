"""Define the terms of the solver's objective, on landmark positions and on poses."""
