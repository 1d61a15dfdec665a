"""Verbs that read, called as the command line calls them, on small files."""
