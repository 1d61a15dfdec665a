"""The landmark network for other programs."""
