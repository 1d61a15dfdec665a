"""Model plausible poses of the 21 body joints with latent codes, energies and samples."""
