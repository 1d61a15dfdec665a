"""Minimise least-squares problems and other costs on manifolds. Nothing here depends on bodies or files."""
