"""Inputs that are larger than anybody films, and what the program needs for them."""
