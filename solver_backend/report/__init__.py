"""One page about a solve: how good it is, where to look, how it was made. No outside resources. Opens offline."""
