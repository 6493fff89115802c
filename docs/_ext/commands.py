"""The command lines as Markdown, from their parsers."""

import argparse
import contextlib
import importlib
import re
import sys
from unittest import mock

MODULES = {
    "training": ["train"],
    "experiments": ["evaluate", "static_search", "appld", "demonstrate", "bags_to_dataset"]
    + ["new_robot", "check_robot", "try_robot", "compare_recording", "report.__main__"],
    "worlds": ["draw"],
    "sim_bridge": ["check"],
    "applr_ros1.nodes.tools": ["barn", "measure_braking", "record", "rviz"],
}
PACKAGE = {"experiments": "training"}


class _Parsed(Exception):
    """Ends a command once its parser is complete."""


def commands(group):
    """Usage and options of each command of a group of MODULES."""
    package = PACKAGE.get(group, group)
    return "\n\n".join(_command("%s.%s" % (package, name)) for name in MODULES[group])


def _command(module):
    """A heading, what the command does, and a table of options for each group."""
    parser = _parser(module)
    name = "python -m " + module.replace(".__main__", "")
    if parser.prog.endswith(".py") and not parser.prog.startswith("_"):
        name = "rosrun applr_ros1 " + parser.prog
    if parser.prog.startswith("./applr "):
        name = parser.prog
    parts = ["## `%s`" % name, _paragraphs(parser.description or ""), "```text\n%s\n```" % _usage(parser, name)]
    for group in parser._action_groups:
        actions = [action for action in group._group_actions if not isinstance(action, argparse._HelpAction)]
        if actions:
            title = group.title if group.title not in ("options", "positional arguments") else ""
            parts += ["### " + title] if title else []
            parts += ["\n".join(_option(parser, action) for action in actions)]
    return "\n\n".join(filter(None, parts))


def _parser(module):
    """The parser that a command makes: it is stopped when it parses."""
    caught = []

    def stop(parser, *args, **more):
        caught.append(parser)
        raise _Parsed

    imported = importlib.import_module(module)
    patched = mock.patch.multiple(argparse.ArgumentParser, parse_known_args=stop)
    with patched, mock.patch.object(sys, "argv", [module]), contextlib.suppress(_Parsed):
        imported.main()
    return caught[0]


def _usage(parser, name):
    """`name ARGUMENTS [options]`."""
    places = [action for action in parser._actions if not action.option_strings]
    words = [parser._get_formatter()._format_args(action, action.metavar or action.dest) for action in places]
    return " ".join([name, *words, "[options]" if len(parser._actions) > 1 + len(places) else ""]).rstrip()


def _option(parser, action):
    """One option as an item of a list."""
    spelled = ", ".join(action.option_strings) or action.metavar or action.dest
    if action.option_strings and action.nargs != 0:
        spelled += " " + parser._get_formatter()._format_args(action, action.metavar or action.dest.upper())
    text = parser._get_formatter()._expand_help(action) if action.help else ""
    return "- **`%s`** %s" % (spelled, _escaped(text))


def _paragraphs(text):
    """A docstring's text; indented lines stay as they are."""
    return re.sub(r"\n\n((?:    .*\n?)+)", r"\n\n\1\n", _escaped(text.strip()))


def _escaped(text):
    """Plain text as Markdown, with options as code and pages of the site as links."""
    text = text.replace("<", "\\<").replace("*", "\\*").replace("~", "\\~")
    text = re.sub(r"(?<![\w`-])(--[a-z][\w-]*\w)", r"`\1`", text)
    return re.sub(r"docs/([\w/]+)\.md", r"[docs/\1.md](../\1.md)", text)
