"""Compare methods on benchmark captures: stored runs, their evaluation, tables and pictures."""
