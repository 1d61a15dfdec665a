"""Render pictures of a baked take with Workbench, without a GPU."""
