"""Named errors of a wand's recording."""

from __future__ import annotations

from solver_backend.exchange.errors import MocapError


class WandNotSeen(MocapError):
    """A sensor never saw the wand, or never at a moment at which another one did."""

    code = "wand_not_seen"


class WandAmbiguous(MocapError):
    """More than one wand, or something else that shines, stood before the sensors."""

    code = "wand_ambiguous"


class WandInvalid(MocapError):
    """The wand's lengths are not such that its lights can be distinguished, or are not those that were seen."""

    code = "wand_invalid"


class TimesInvalid(MocapError):
    """A recording's times do not grow."""

    code = "times_invalid"
