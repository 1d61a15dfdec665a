"""Minimise least-squares problems and other costs on manifolds. Independent of bodies and files."""
