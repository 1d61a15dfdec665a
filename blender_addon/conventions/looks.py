"""What a body can look like, by name."""

from __future__ import annotations

PERSON_LOOK, MANNEQUIN = "person", "mannequin"
LOOKS = (PERSON_LOOK, MANNEQUIN)
