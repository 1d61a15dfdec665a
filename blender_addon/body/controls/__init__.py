"""Controls of animators: a root, hands and feet with IK, poles, and the wires that show them."""
