"""Motions of foreign skeletons onto our body."""
