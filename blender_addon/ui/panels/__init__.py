"""The sidebar tab, in the order of the work: Capture, Cameras, Solve, Review, Export."""
