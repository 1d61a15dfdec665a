"""Bodies that are measured in part: which parts nothing informs, their posture at rest, and how far that may be off."""
