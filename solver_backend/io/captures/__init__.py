"""Read captures from the files and folders of other programs."""
