"""Export takes in the formats of other programs."""
