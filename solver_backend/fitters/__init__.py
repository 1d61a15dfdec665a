"""From a capture to a motion: initialisation, single frames, latent keyframe bundles, the yardstick."""
