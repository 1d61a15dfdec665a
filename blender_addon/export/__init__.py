"""Export takes to the formats of other programs."""
