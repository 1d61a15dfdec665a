"""What the solver minimises: data terms on landmark positions, robust penalties, the pull to rest."""
