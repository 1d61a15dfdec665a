"""Minimise least-squares problems and other costs on manifolds. This package knows neither bodies nor files."""
