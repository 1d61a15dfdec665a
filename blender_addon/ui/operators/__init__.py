"""Operators. Each reads properties, calls one function and reports its result."""
