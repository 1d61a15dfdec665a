"""Reproductions and comparisons of published methods. They are not part of the extension."""
