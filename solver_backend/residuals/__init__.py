"""Terms of what the solver minimises, one a file: on landmark positions, and on poses."""
