"""Operators, which read properties, call one function and report its result."""
