"""``batch``: solve every capture in a folder and, if requested, bake, render and export it."""
