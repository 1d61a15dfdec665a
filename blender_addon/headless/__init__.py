"""The add-on's work without its window: solve, bake, export, render, and all of it for a folder of captures."""
