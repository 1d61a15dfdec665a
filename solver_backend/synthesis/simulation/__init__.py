"""Simulate people, and how cameras see them: occlusion and detector output."""
