"""What several tests share: bodies, priors, scenes and files made small."""
