"""What the benchmark of optical markers measures, one file a question."""
