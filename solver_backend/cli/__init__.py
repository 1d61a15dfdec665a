"""Implement the command line: verbs, exit codes, progress lines. Each verb calls one function of other packages."""
