"""The command line: verbs, exit codes, progress lines; every verb calls one function of the packages below."""
