"""The sidebar tab: Capture, Cameras, Solve, Review, Export, in the order of the work."""
