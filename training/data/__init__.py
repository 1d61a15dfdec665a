"""The training corpus: recordings as body rotations, augmented and cut into windows."""
