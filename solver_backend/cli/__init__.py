"""The command line: verbs, exit codes, progress lines. Every verb calls one function of the packages below."""
