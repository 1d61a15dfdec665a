"""Retarget a solved motion to another character's rig."""
