"""Read and write our own capture and motion files."""
