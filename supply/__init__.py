"""Generate documentation pages, list components and licences, and run checks and tests."""
