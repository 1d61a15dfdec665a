"""Training of pose priors and networks. Only this part needs torch."""
