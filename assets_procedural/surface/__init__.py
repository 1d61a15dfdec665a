"""The implicit surface, and its fit to the reference body."""
