"""Read motions from the files of other programs."""
