"""Takes and measurements for the benchmark of hands."""
