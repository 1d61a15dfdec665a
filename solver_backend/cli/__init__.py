"""Implement the solver's command line. Each verb calls one function in another package."""
