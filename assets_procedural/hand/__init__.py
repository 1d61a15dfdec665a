"""Add movable fingers to the built body: joints, weights, knuckle correctives and sizes."""
