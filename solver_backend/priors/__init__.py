"""Pose priors: what the 21 body joints can do, as latent codes, energies and samples."""
