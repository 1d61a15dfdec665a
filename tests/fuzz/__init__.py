"""Mutated files for every reader: each must return or raise one of our errors, within bounded time and memory."""
