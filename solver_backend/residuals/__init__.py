"""Define the terms of the objective, on landmark positions and on poses."""
