"""Limbs posed joint by joint (FK) or from their ends (IK): from one to the other, the motion kept."""
