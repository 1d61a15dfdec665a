"""Methods side by side on benchmark captures: runs that are kept, their judgement, tables and pictures."""
