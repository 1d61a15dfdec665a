"""Recordings as strangers bring them: other programs' files, and what people get wrong, one or two at once."""
