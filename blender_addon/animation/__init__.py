"""Write motions as actions, with full or sparse keys and with confidence."""
