"""How good a motion is: against a capture's truth, beside what a plain filter reaches."""
