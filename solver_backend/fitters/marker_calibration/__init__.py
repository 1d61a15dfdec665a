"""What stays the same of a person in markers: shape, and every marker's place on the body."""
