"""Controls for animators: a root, IK controls and poles for hands and feet, and their custom shapes."""
