"""Implement the command line. Each verb calls one function of other packages."""
