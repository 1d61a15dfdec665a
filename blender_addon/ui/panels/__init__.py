"""The sidebar tab, in workflow order: Capture, Cameras, Solve, Review, Export."""
