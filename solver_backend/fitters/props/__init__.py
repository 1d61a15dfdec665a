"""Props: groups of markers that move as rigid bodies and are worn by nobody, in six degrees of freedom."""
