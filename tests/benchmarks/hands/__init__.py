"""What the benchmark of hands measures on."""
