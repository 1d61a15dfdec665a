"""Controls for animators: a root, IK controls and poles for hands and feet, and the custom shapes of all."""
