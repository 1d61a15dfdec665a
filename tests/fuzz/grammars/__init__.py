"""Documents drawn by the grammar of their format with hypothesis: well-formed, and odd in what they say."""
