"""Unusually large inputs, and the time and memory that the program needs for them."""
