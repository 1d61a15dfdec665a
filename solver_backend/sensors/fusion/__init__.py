"""From what each sensor saw to one cloud: which sightings are one marker, which points go on, which are ghosts."""
