"""Generator of the neutral body: committed numbers in, one skinned and shaped body file out."""
