"""Which marker each point of an unlabelled cloud is, and where those are that nobody sees."""
