"""Simulate a camera's view of moving bodies: occlusion and detector output."""
