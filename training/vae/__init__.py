"""Train the variational autoencoders (thesis 4.2.4)."""
