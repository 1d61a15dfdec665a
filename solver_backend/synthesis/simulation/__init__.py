"""Simulate how a camera sees moving bodies: occlusion and detector output."""
