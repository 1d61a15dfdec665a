"""Maps: which bone of a rig plays which role."""
