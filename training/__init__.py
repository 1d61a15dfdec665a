"""Train pose priors and networks. Only this package needs torch."""
