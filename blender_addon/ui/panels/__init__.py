"""Panels of the sidebar tabs, in workflow order."""
