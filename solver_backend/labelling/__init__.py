"""Names for the points of an unlabelled cloud, and places of hidden markers."""
