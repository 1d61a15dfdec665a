"""Which way is up and where the floor is, from three markers laid down as a Γ."""
