"""Model plausible poses of the 21 body joints: latent codes, energies and samples."""
