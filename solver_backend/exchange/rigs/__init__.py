"""Recognise the roles of bones in rigs from any program."""
