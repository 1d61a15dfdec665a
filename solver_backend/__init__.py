"""Manifold MoCap's solver: captures in, motions of an SMPL-type body out (never imports bpy)."""

__version__ = "0.1.0"
