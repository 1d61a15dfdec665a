"""Hands of the studio's people: how fingers move, who sees them, and what a detector makes of them."""
