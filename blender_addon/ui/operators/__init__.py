"""Operators: each reads properties, calls one function, reports."""
