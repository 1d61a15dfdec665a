"""Recognise the roles of bones in rigs and skeletons of any program, from names and structure."""
