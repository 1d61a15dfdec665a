"""Captures of several views spoiled as people's are, and what becomes of them."""
