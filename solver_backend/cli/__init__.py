"""Implement the command line. Each verb calls one function in another package."""
