"""Export takes to formats of other programs."""
