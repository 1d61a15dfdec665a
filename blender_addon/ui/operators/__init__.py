"""Operators of the buttons and menus. Each reads its settings, calls one function and reports the result."""
