"""Define the unknowns of a solve: poses, latent codes and the curves through keyframes."""
