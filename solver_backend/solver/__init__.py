"""Minimise least-squares problems and other costs on manifolds, independently of bodies and files."""
