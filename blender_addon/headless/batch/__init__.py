"""``batch``: solve every capture in a folder and optionally bake, render and export it."""
