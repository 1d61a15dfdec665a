"""Define the command verbs as table rows, from which parsers, help, panels and pages are derived."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

from .errors import CommandLineInvalid, ExitCode
from .outputs import check_output
from .plain_text import either
from .setting import POSITIVE, REQUIRED, Choice, Kind, Setting, is_list, text_of_value

_AS_WRITTEN = argparse.RawDescriptionHelpFormatter
_PROPER_NAMES = ("Blender", "Dask", "Python")  # Words that stay capitalised within a sentence.


@dataclass(frozen=True)
class Verb:
    """A verb (subcommand) of the command line program, such as ``solve``."""

    name: str  # Words after the program name: the group, if any, and the verb.
    help: str  # What the verb does, in lower case without full stop.
    example: str  # Example command line without the program name.
    run: str  # ``module:function`` in the program's package, imported when the verb runs.
    declared: Callable[[], tuple[Setting, ...]] = tuple  # Returns the settings when they are first needed.
    passes_on: bool = False  # True if it accepts all options of the solver verb with the same name.
    needs_blender: bool = False  # True if Blender is loaded before the verb runs.
    hidden: bool = False  # True for child processes of the program. Omitted from help and reference pages.
    writes: str = ""  # Result key of the file that ``--out`` writes, which the runner reports.

    @cached_property
    def settings(self) -> tuple[Setting, ...]:
        """The verb's settings, created only when the verb runs."""
        return self.declared()

    @property
    def group(self) -> str:
        """The verb's group, or "" if none."""
        return self.name.rpartition(" ")[0]

    @property
    def rows(self) -> dict[str, Setting]:
        """The verb's settings by name."""
        return {row.name: row for row in self.settings}

    def load(self, package: str) -> Callable[..., Any]:
        """Import and return the function that runs the verb."""
        module, _, function = self.run.partition(":")
        return getattr(import_module(f"{package}.{module}"), function)

    def given(self, args: argparse.Namespace) -> dict[str, Any]:
        """Return the parsed values that differ from their defaults, by name."""
        values = {row.name: getattr(args, row.name) for row in self.settings}
        left_out = {row.name: None if row.of_class else row.default for row in self.settings}
        return {name: value for name, value in values.items() if value != left_out[name]}

    def arguments(self, **values: Any) -> argparse.Namespace:
        """Return parsed arguments with these values, and defaults for all other settings."""
        if unknown := values.keys() - self.rows.keys():
            raise KeyError(f"{self.name} has no {', '.join(unknown)}")
        return argparse.Namespace(verb=self.name, rest=[], **{row.name: row.default for row in self.settings} | values)

    def words(self, values: Mapping[str, Any]) -> list[str]:
        """Return the command line arguments for values by name. None and defaults are omitted."""
        rows = self.rows
        given = {name: value for name, value in values.items() if value != rows[name].default}
        ordered = sorted(given, key=lambda name: not rows[name].positional)
        return [word for name in ordered for word in rows[name].words(given[name])]


def option(kind: Kind, name: str, metavar: str, description: str, default: Any = None, **more: Any) -> Setting:
    """Declare an option of a verb. If the default is ``REQUIRED``, the user must specify the option."""
    given: dict[str, Any] = {"label": name.replace("_", " ").title(), "required": default is REQUIRED, **more}
    own = None if default is REQUIRED else default
    return Setting(kind, description=description, name=name, default=own, metavar=metavar, **given)


def place(kind: Kind, name: str, metavar: str, description: str, default: Any = REQUIRED, **more: Any) -> Setting:
    """Declare a positional argument of a verb. See ``option``."""
    return option(kind, name, metavar, description, default, positional=True, **more)


def flag(name: str, description: str, **more: Any) -> Setting:
    """Declare an option that is off unless given. See ``option``."""
    return option("flag", name, "", description, False, **more)


def output(metavar: str, description: str, default: Any = REQUIRED, kind: Kind = "path", **more: Any) -> Setting:
    """Declare the option ``-o``, ``--out``. The path is checked before work begins."""
    return option(kind, "out", metavar, description, default, **{"option": "-o --out", "is_output": True, **more})


def values(*texts: str) -> tuple[Choice, ...]:
    """Return choices without descriptions, with labels derived from their values."""
    return tuple(Choice(text, text.replace("_", " ").title(), "") for text in texts)


def by_name(verbs: Iterable[Verb]) -> dict[str, Verb]:
    """Map names to verbs."""
    return {verb.name: verb for verb in verbs}


# Command line


class Parser(argparse.ArgumentParser):
    """Argument parser that raises ``CommandLineInvalid`` instead of ending the process."""

    rows: Collection[Setting] = ()

    def error(self, message: str) -> NoReturn:
        """Raise ``CommandLineInvalid``. Its hint is the option's help, a suggested word, or the usage."""
        hint = " ".join(["Usage:", *self.format_usage().split()[1:]])
        if named := re.fullmatch(r"argument (\S+): (.*)", message, re.DOTALL):
            name, text = named[1].split("/")[-1], named[2]
            if row := next((row for row in self.rows if name in (*row.options, row.name, row.metavar)), None):
                hint = " ".join(dict.fromkeys((name, row.metavar or name))) + f": {help_of(row)}."
                if text.startswith("invalid choice: "):
                    given, known = text.split("'")[1], [choice.value for choice in row.choices]
                    text, hint = f"{given!r} is unknown. Known: {', '.join(known)}", suggest(given, known) or hint
            message = f"{name}: {text}"
        elif names := message.partition(" required: ")[2]:
            message = f"{names} {'are' if ',' in names else 'is'} missing"
        raise CommandLineInvalid(f"{message[:1].upper()}{message[1:]}.", where=self.prog, hint=hint)

    def add_settings(self, rows: Collection[Setting], *, everything: bool = True) -> None:
        """Add settings to the parser by group. If ``everything`` is True, the help includes rare settings."""
        sections: dict[str, Any] = {"": self}
        exclusive: dict[str, Any] = {}
        for row in rows:
            section = sections.get(row.group) or sections.setdefault(row.group, self.add_argument_group(row.group))
            if row.excludes:
                section = exclusive.get(row.excludes) or section.add_mutually_exclusive_group()
                exclusive[row.excludes] = section
            _add(section, row, shown=everything or not row.rare)
        self.rows = rows


def parse_script(description: str | None, *settings: Setting, argv: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the command line of a program without verbs. Exit with code 2 if it is invalid."""
    parser = Parser(description=description)
    parser.add_settings(settings)
    try:
        return parser.parse_args(argv)
    except CommandLineInvalid as error:
        parser.exit(ExitCode.USAGE, f"{error}\n")


@dataclass(frozen=True)
class Program:
    """A command line program with several verbs."""

    name: str  # Program name in front of the verb.
    description: str
    verbs: Mapping[str, Verb]
    common: Callable[[], tuple[Setting, ...]]  # Settings that every verb has.
    epilog: str
    version: str = ""
    groups: Mapping[str, str] = field(default_factory=dict)  # What each group does, by name.

    @property
    def shown(self) -> list[Verb]:
        """The verbs that are shown to users."""
        return [verb for verb in self.verbs.values() if not verb.hidden]

    def parse(self, argv: list[str]) -> argparse.Namespace:
        """Parse a command line. Return ``verb``, its settings, and the remaining arguments as ``rest``.

        Raises:
            CommandLineInvalid: the command line is invalid. The hint is the usage or the most similar known word.
        """
        words = [*argv[0].split(" "), *argv[1:]] if argv else []  # Programs pass a verb as one word.
        group = words.pop(0) if words and words[0] in self.groups else ""
        if not words or words[0].startswith("-"):
            parser = self.parser(group)
            parser.parse_known_args(words)
            hint = f"{parser.prog} --help lists the verbs."
            raise CommandLineInvalid("VERB is missing.", where=parser.prog, hint=hint)
        name = f"{group} {words.pop(0)}".strip()
        if name not in self.verbs:
            own = ", ".join(verb.name.split(" ")[1] for verb in self.shown if group == verb.name.split(" ")[0])
            listed = f"{group} needs one of its verbs: {own}." if group else f"{self.name} --help lists the verbs."
            hint = self._suggest_verb(name) or listed
            raise CommandLineInvalid(f"There is no verb {name!r}.", where=self.name, hint=hint)
        verb = self.verbs[name]
        if "--help-all" in words:
            self.parser_of(verb, everything=True).parse_args(["--help"])
        parser = self.parser_of(verb)
        args, rest = parser.parse_known_args(_with_signed_axis(words))
        if rest and not verb.passes_on:
            known = ["--help-all", *(option for row in (*verb.settings, *self.common()) for option in row.options)]
            near = suggest(rest[0].partition("=")[0], known)
            if near:
                raise CommandLineInvalid(f"Unrecognized arguments: {' '.join(rest)}.", where=parser.prog, hint=near)
            parser.error(f"unrecognized arguments: {' '.join(rest)}")
        args.verb, args.rest = verb.name, rest
        return args

    def parser(self, group: str = "") -> Parser:
        """Return the parser for the program, or for a group of its verbs. Its help lists the verbs."""
        name, of_group = f"{self.name} {group}".strip(), self.groups.get(group, "")
        about = f"{of_group[:1].upper()}{of_group[1:]}." if group else self.description
        usage = f"{name} [-h]{' [--version]' * bool(self.version and not group)} VERB ..."
        description = f"{about} VERB --help lists a verb's options."
        epilog = self._list_verbs(group) + f"\n\n{self.epilog}" * (not group)
        whole = Parser(prog=name, usage=usage, description=description, epilog=epilog, formatter_class=_AS_WRITTEN)
        if self.version and not group:
            whole.add_argument("--version", action="version", version=self.version)
        return whole

    def parser_of(self, verb: Verb, *, everything: bool = False) -> Parser:
        """Return the parser for one verb. ``everything`` includes rare settings in its help."""
        name, description = f"{self.name} {verb.name}", f"{verb.help[:1].upper()}{verb.help[1:]}."
        rows = (*verb.settings, *self.common())
        left_out = 0 if everything else sum(row.rare and not row.hidden for row in rows)
        more = f"{left_out} rarely used options: --help-all\n\n" if left_out else ""
        epilog = f"{more}example:\n  {self.name} {verb.example}"
        usage = " ".join([name, *filter(None, map(_in_usage, rows)), "[options]"])
        own = Parser(prog=name, usage=usage, description=description, epilog=epilog, formatter_class=_AS_WRITTEN)
        own.add_settings(rows, everything=everything)
        return own

    def _list_verbs(self, group: str) -> str:
        rows = {verb.name.split()[-1]: verb.help for verb in self.shown if verb.group == group}
        parts = [("verbs", rows)] if group else [("verbs", rows), ("groups of verbs", self.groups)]
        width = max(len(name) for _, part in parts for name in part) + 2
        lists = ([f"{title}:", *(f"  {name:{width}}{text}" for name, text in part.items())] for title, part in parts)
        return "\n\n".join("\n".join(lines) for lines in lists if lines[1:])

    def _suggest_verb(self, name: str) -> str:
        """Return a question that suggests verbs with the same words, or the most similar verb."""
        words = set(re.split("[ -]", name))
        same = [known for known in self.verbs if words <= set(re.split("[ -]", known))]
        return f"Did you mean {either(same)}?" if same else suggest(name, self.verbs)


def _in_usage(row: Setting) -> str:
    word = (row.metavar or row.name.upper()) + " ..." * row.many
    if row.positional:
        return word if row.required or row.many else f"[{word}]"
    return f"{row.options[0]} {word}" if row.required else ""


def check_outputs(verb: Verb, args: argparse.Namespace) -> None:
    """Check that a verb can write all its output files."""
    for row in verb.settings:
        path = getattr(args, row.name) if row.is_output else None
        if path is not None:
            check_output(path, overwrite=bool(getattr(args, "overwrite", False)))


def suggest(word: str, known: Iterable[str], likeness: float = 0.6) -> str:
    """Return a question that suggests the most similar known word, or "" if no word is similar."""
    from difflib import get_close_matches  # needed only for mistakes, and slow to import

    near = get_close_matches(word, list(known), 1, likeness)
    return f"Did you mean {near[0]}?" if near else ""


def describe_range(row: Setting) -> str:
    """Return a setting's valid values in a few words, or "" if its metavar states them."""
    if row.kind == "choice":
        return ", ".join(choice.value for choice in row.choices)
    if row.low is None or row.kind == "numbers":
        return ""
    low, high = (f"{bound or 0:,.6f}".rstrip("0").rstrip(".") for bound in (row.low, row.high))
    bounds = "" if row.high is None else f"up to {high}" if row.low == POSITIVE else f"{low} to {high}"
    return " ".join(filter(None, (bounds, row.unit)))


def describe_default(row: Setting) -> str:
    """Return a setting's default as text, or "" if there is none."""
    value = row.default
    if isinstance(value, bool):
        return "" if row.kind == "flag" else "on" if value else "off"
    if is_list(value):
        return " ".join(map(text_of_value, value))
    return text_of_value(value) if value or (value == 0 and row.of_class) else ""


def help_of(row: Setting) -> str:
    """Return a setting's help text, with description, range and default."""
    bounds, default = _range_in_help(row), describe_default(row)
    several = row.repeated or row.kind == "texts"
    more = [bounds] * bool(bounds) + [f"default {default}"] * bool(default) + ["may be repeated"] * several
    return in_sentence(row.description) + (f" ({', '.join(more)})" if more else "")


def _range_in_help(row: Setting) -> str:
    if row.kind != "choice" or row.of_class or row.metavar not in ("", "NAME"):
        return describe_range(row)
    described = [f"{choice.value}: {in_sentence(choice.description)}" for choice in row.choices if choice.description]
    return ", ".join(described)  # argparse lists the values


def in_sentence(text: str) -> str:
    """Convert a description for use within a sentence. Only proper names stay capitalised."""
    word = text.split(maxsplit=1)[0].rstrip(",;:'s")
    is_name = word in _PROPER_NAMES or (not word[1:].islower() and len(word) > 1)
    return text if is_name else f"{text[0].lower()}{text[1:]}"


def _add(section: Any, row: Setting, *, shown: bool) -> None:
    given: dict[str, Any] = {"help": help_of(row).replace("%", "%%") if shown and not row.hidden else argparse.SUPPRESS}
    if row.kind == "switch":
        given["action"] = argparse.BooleanOptionalAction
    elif row.kind == "flag":
        given["action"] = "store_true"
    else:
        metavar = row.metavar or {"whole": "N", "number": "X"}.get(row.kind)
        several = row.kind == "range" or (row.count > 1 and row.kind != "numbers")
        given |= {"type": _Reader(row), "metavar": tuple(metavar.split()) if several and metavar else metavar}
        if several:
            given["nargs"] = row.count or 2
        elif row.many:
            given["nargs"] = "+"
        elif row.repeated or row.kind == "texts":
            given["action"] = "append"
        if row.kind == "choice" and not row.of_class:
            given["choices"] = [choice.value for choice in row.choices]
            given["metavar"] = metavar if metavar != "NAME" else None
    several = row.many or row.repeated
    default = None if row.of_class or row.default is None else list(row.default) if several else row.default
    if row.positional:
        given |= {"default": default} if row.default is not None else {}
        given |= {} if row.required or row.many else {"nargs": "?"}
        section.add_argument(row.name, **given)
    else:
        section.add_argument(*row.options, dest=row.name, default=default, required=row.required, **given)


class _Reader:
    """Parses one value of a setting. It is a class because argparse uses its ``__name__`` in messages."""

    def __init__(self, row: Setting) -> None:
        self._row = row
        self.__name__ = {"whole": "int", "number": "float"}.get(row.kind, row.kind)

    def __call__(self, text: str) -> Any:
        row = self._row
        if row.kind in ("path", "folder"):
            if row.endings and Path(text).suffix.lower() not in row.endings:
                raise argparse.ArgumentTypeError(f"{text} must end in {either(row.endings)}")
            return Path(text)
        if row.kind == "numbers":
            return self._checked(text, _numbers(text))
        if row.kind in ("whole", "range"):
            return self._checked(text, _number(text, int, "a whole number"))
        return self._checked(text, _number(text, float, "a number")) if row.kind == "number" else text

    def _checked(self, text: str, value: Any) -> Any:
        row = self._row
        if row.of_class or row.kind == "range" or row.accepts(value):
            return value
        raise argparse.ArgumentTypeError(f"{text} is not valid. It must be {row.expected}")


def _number(text: str, kind: Callable[[str], Any], called: str) -> Any:
    try:
        return kind(text)
    except ValueError:
        point = f"; write {text.replace(',', '.')}" if re.fullmatch(r"-?\d+,\d+", text) else ""
        raise argparse.ArgumentTypeError(f"{text!r} is not {called}{point}") from None


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text} is not a list of numbers separated by commas") from None


def _with_signed_axis(argv: list[str]) -> list[str]:
    """Join ``--up-axis -y`` into one argument, because argparse mistakes a signed axis for an option."""
    joined: list[str] = []
    for argument in argv:
        if joined and joined[-1] == "--up-axis" and argument.lower() in ("-x", "-y", "-z"):
            joined[-1] = f"--up-axis={argument}"
        else:
            joined.append(argument)
    return joined
