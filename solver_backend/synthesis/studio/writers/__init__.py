"""A shot written as other programs read it."""
