"""From a specification that a person types ("generated:7", a file, a folder) to worlds. Everything loads through here."""
from __future__ import annotations

from typing import List

from . import generator
from .world import World, WorldError

GENERATED = "generated:"
FORMS = "generated:N (0-%d), generated:train, generated:test, physical_course, a .world file or a folder of them" % (
    generator.COUNT - 1)


def load(spec: str) -> World:
    """One world. Raises WorldError with one line."""
    text = str(spec)
    if text.startswith(GENERATED):
        return _generated(text)
    raise WorldError("unknown world %r; give %s" % (text, FORMS))


def load_all(spec: str) -> List[World]:
    """All worlds that a specification names, in a fixed order. Raises WorldError with one line."""
    return [load(spec)]


def _generated(text: str) -> World:
    try:
        number = int(text[len(GENERATED):])
    except ValueError:
        raise WorldError("world %r is not a number; give %s" % (text, FORMS)) from None
    if not 0 <= number < generator.COUNT:
        raise WorldError("world %r does not exist; built-in worlds are generated:0 to generated:%d"
                         % (text, generator.COUNT - 1))
    return generator.generate(number)
