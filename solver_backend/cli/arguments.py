"""What may stand on the command line."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import NoReturn

from solver_backend.cli.pose_arguments import prior_options
from solver_backend.cli.setting_options import READING_ROWS, add_settings
from solver_backend.cli.verb_table import TASKS, VERBS, Shared
from solver_backend.cli.video_arguments import detector_options, footage_options
from solver_backend.exchange.errors import CommandLineInvalid, describe_exit_codes
from solver_backend.exchange.version import VERSION

EPILOG = (
    describe_exit_codes(
        "a file is missing, damaged or unusable, the output cannot be written, or a solve with --strict has warnings",
        "the solver failed",
    )
    + "Messages for people go to standard error."
)


class _Parser(argparse.ArgumentParser):
    """Raises our own error where argparse would end the process."""

    def error(self, message: str) -> NoReturn:
        raise CommandLineInvalid(
            f"{message[:1].upper()}{message[1:]}.",
            where=self.prog,
            hint=" ".join(["Usage:", *self.format_usage().split()[1:]]),
        )


def parse(argv: list[str]) -> argparse.Namespace:
    """Return the parsed command line.

    Raises:
        CommandLineInvalid: it makes no sense; the hint is the usage.
    """
    return build_parser().parse_args(_with_signed_axis(argv))


def _with_signed_axis(argv: list[str]) -> list[str]:
    """Return the arguments with ``--up-axis -y`` in one, for argparse takes an axis with a sign for an option."""
    joined: list[str] = []
    for argument in argv:
        if joined and joined[-1] == "--up-axis" and argument.lower() in ("-x", "-y", "-z"):
            joined[-1] = f"--up-axis={argument}"
        else:
            joined.append(argument)
    return joined


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line: the verbs of the table, grouped by task in its help."""
    shared = {name: _parent(add) for name, add in _SHARED.items()}
    common = _parent(_common)
    parser = _Parser(
        prog="python -m solver_backend",
        description="Turns multi-view keypoints or optical markers into the motion of an SMPL-type body.",
        epilog=f"{_list_verbs()}\n\n{EPILOG}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"Manifold MoCap {VERSION}")
    verbs = parser.add_subparsers(
        dest="verb",
        required=True,
        metavar="VERB",
        parser_class=_Parser,
        help="what to do; VERB --help lists its options",
    )  # fmt: skip
    for verb in VERBS.values():
        own = verbs.add_parser(
            verb.name,
            parents=[*(shared[name] for name in verb.shared), common],
            description=f"{verb.help[:1].upper()}{verb.help[1:]}.",
            epilog=f"example:\n  {parser.prog} {verb.example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if verb.add_arguments is not None:
            verb.add_arguments(own)
    return parser


def _list_verbs() -> str:
    """Return the verbs by task, one a line with its help."""
    width = max(map(len, VERBS)) + 2
    return "\n\n".join(
        "\n".join([f"{task}:", *(f"  {verb.name:{width}}{verb.help}" for verb in rows)]) for task, rows in TASKS.items()
    )


def _parent(add: Callable[[argparse.ArgumentParser], None]) -> _Parser:
    """Return a parser whose options several verbs take."""
    options = _Parser(add_help=False)
    add(options)
    return options


def _common(options: argparse.ArgumentParser) -> None:
    options.add_argument("--json", action="store_true", help="progress and result as JSON lines on standard output")
    options.add_argument("--parent-pipe", action="store_true", help=argparse.SUPPRESS)
    options.add_argument("-v", "--verbose", action="store_true", help="log details to standard error")


def _reading(options: argparse.ArgumentParser) -> None:
    add_settings(options, ("sync", *READING_ROWS))


def _writing(options: argparse.ArgumentParser) -> None:
    options.add_argument("--overwrite", action="store_true", default=None, help="replace existing results")


_SHARED: dict[Shared, Callable[[argparse.ArgumentParser], None]] = {
    "reading": _reading, "writing": _writing, "detector": detector_options, "footage": footage_options,
    "prior": prior_options,
}  # fmt: skip
"""What adds the options that several verbs share."""
