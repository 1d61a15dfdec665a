"""Compute joints, skinning weights, the regressor and pose correctives."""
