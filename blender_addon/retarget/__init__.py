"""Retarget: a solved motion on another character's rig."""
