"""Recognise the roles of bones in rigs of any program."""
