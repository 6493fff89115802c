"""The base of the project's exceptions, and the wrapper that turns them into one line and an exit status."""

from __future__ import annotations

import importlib
import os
import signal
import sys
import traceback
from typing import Callable, Optional

OURS = ("applr_ros1", "sim_bridge", "training", "worlds")
_ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.realpath(__file__))))
_LIBRARIES = tuple(
    os.path.join(folder, "")
    for folder in (os.path.dirname(os.path.realpath(os.__file__)), *(os.path.join(_ROOT, name) for name in OURS))
)


class ApplrError(ValueError):
    """Something that a user can put right. Its text is one line: what is wrong, which value, what to do.

    exit_status: what a command that ends with this error returns to the shell.
    """

    exit_status = 1


class UsageError(ApplrError):
    """A command-line argument that cannot be."""


def reason(error: BaseException) -> str:
    """Why the system refused, in its own words, without the error number and the path."""
    return getattr(error, "strerror", None) or (str(error).splitlines() or [type(error).__name__])[0]


def one_line(error: BaseException) -> str:
    """What went wrong, for people: the text of this package's own errors, the kind and the text of all others."""
    if isinstance(error, ApplrError):
        return str(error)
    return "%s: %s" % (type(error).__name__, _with_file(error))


def with_place(error: BaseException) -> str:
    """As one_line(), with the file and line in a person's own code that raised it: "KeyError: 'v' (FILE, line 9)".

    Files of this package, of Python and of installed libraries are not a person's own: the last other one is named.
    """
    text = one_line(error)
    if isinstance(error, (ApplrError, SyntaxError)):  # the latter says so itself
        return text
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        folder, file = os.path.split(os.path.realpath(frame.filename))
        if not (frame.filename.startswith("<") or (folder + os.sep).startswith(_LIBRARIES) or "-packages" in folder):
            return "%s (%s, line %d)" % (text, file, frame.lineno or 0)
    return text


def _with_file(error: BaseException) -> str:
    """The reason, after the file that it is about, where there is one."""
    where = "%s: " % error.filename if isinstance(error, OSError) and error.filename else ""
    return where + reason(error)


def run_main(main: Callable[[], Optional[int]], program: str) -> int:
    """Runs a command and returns its exit status.

    ApplrError and OSError become one line "PROGRAM: ..." on stderr and the error's exit status, Ctrl-C becomes 130
    (with the text of the KeyboardInterrupt, if it has one). Other exceptions are defects and pass through.

    Args:
        main: the command; returns an exit status, or None for 0.
        program: what the person called it, for instance "evaluate.py".
    """
    try:
        return main() or 0
    except KeyboardInterrupt as stopped:
        print("%s: %s" % (program, str(stopped) or "stopped"), file=sys.stderr)
        return 128 + signal.SIGINT
    except ApplrError as error:
        print("%s: %s" % (program, "\\n".join(str(error).splitlines())), file=sys.stderr)  # a path may hold newlines
        return error.exit_status
    except OSError as error:
        print("%s: %s" % (program, _with_file(error)), file=sys.stderr)
        return 1


def run_script(module: str, node: bool = False) -> int:
    """Imports the module of a command, runs its main() and returns the exit status. For the files in scripts/.

    The import takes seconds, and Ctrl-C meanwhile is one line as well; so is a Python package that is missing. The
    folder of the script is taken from sys.path: its sim_bridge.py would hide the package of that name.

    Args:
        module: such as "training.evaluate".
        node: whether it is a ROS node, which takes nothing but NAME:=VALUE. Other words end it with one line, before
            it does what nobody asked for; --help prints the module's USAGE, else its docstring.
    """
    if os.path.isfile(os.path.join(sys.path[0], "sim_bridge.py")):
        sys.path.pop(0)
    program = os.path.splitext(os.path.basename(sys.argv[0]))[0]
    if not program or program.startswith("-"):  # python -c
        program = module.rpartition(".")[2]
    try:
        return run_main(lambda: _main_of(module, node), program)
    except ModuleNotFoundError as missing:
        name = (missing.name or "").partition(".")[0]
        if not name or name in OURS:
            raise
        print(
            "%s: Python's %s is not installed for %s: run ./applr packages in the repository of applr_ros1, "
            "then build this workspace again" % (program, name, sys.executable),
            file=sys.stderr,
        )
        return 1


def _main_of(module: str, node: bool) -> Optional[int]:
    from applr_ros1.common.arguments import without_remappings

    loaded = importlib.import_module(module)
    words = without_remappings() if node else []
    if {"-h", "--help"} & set(words):
        print(getattr(loaded, "USAGE", loaded.__doc__))
        return 0
    if words:
        raise UsageError("%s: give parameters as _NAME:=VALUE; --help says which there are" % " ".join(words))
    return loaded.main()
