"""Train pose priors and networks. This is the only package that needs torch."""
