"""Hands on a solved body: wrists, fingers, and arms that follow."""
