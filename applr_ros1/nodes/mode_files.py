"""The files in the launch argument `mode`, with their folders: the nodes run in another folder than the person.

Called by arguments.py, which checks what this returns and hands it to the launch file, and by the demo.
"""

from __future__ import annotations

import os
import sys
from importlib.machinery import PathFinder

from applr_ros1.policy.methods.registry import FILES, METHODS, MODES, OWN


def absolute(mode: str) -> str:
    """A mode in which all files are given from the root.

    Args:
        mode: One of MODES, or any other specification of a method (policy/methods/registry.py).

    Returns:
        The mode with absolute paths. A module that only the current folder has becomes the path of its file, and so
        does the text for the constructor of a class of one's own where it is the path of a file.
    """
    if mode in METHODS or mode in MODES:
        return mode
    kind, colon, rest = mode.partition(":")
    if kind in ("frozen", "period") and colon:
        word, inner_colon, inner = rest.partition(":")
        return kind + colon + word + inner_colon + absolute(inner)
    if kind in FILES and colon:
        return kind + colon + (os.path.abspath(rest) if rest else "")
    own = OWN.match(mode)
    if own:
        module, name, text = own.groups()
        return from_the_root(module) + ":" + name + ("" if text is None else ":" + _text(text))
    return os.path.abspath(mode) if mode.endswith((".safetensors", ".json")) else mode


def from_the_root(module: str) -> str:
    """The absolute path of a .py file; a module's name where Python finds it without the current folder."""
    if module.endswith(".py"):
        return os.path.abspath(module)
    path = module.replace(".", os.sep) + ".py"
    here = os.path.realpath(os.curdir)  # whoever made the method before may have put it on sys.path
    given = [
        os.path.realpath(folder) for folder in os.environ.get("PYTHONPATH", "").split(":") if os.path.isabs(folder)
    ]
    elsewhere = [folder for folder in sys.path if here in given or os.path.realpath(folder or os.curdir) != here]
    only_here = os.path.isfile(path) and PathFinder.find_spec(module.partition(".")[0], elsewhere) is None
    return os.path.abspath(path) if only_here else module


def _text(text: str) -> str:
    """The text for a constructor, absolute where it is the path of a file: a word or a number is none."""
    return os.path.abspath(text) if ("." in text or os.sep in text) and os.path.isfile(text) else text
