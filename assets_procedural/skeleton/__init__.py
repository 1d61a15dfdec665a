"""Joints, skinning weights, regressor and pose correctives."""
