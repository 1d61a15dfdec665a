"""Props: groups of markers that move as rigid bodies off the person, in six degrees of freedom."""
