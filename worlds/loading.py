"""From a specification that a person types ("generated:7", a file, a folder) to worlds.

Everything loads through here.
"""

from __future__ import annotations

import dataclasses
import os
import re
from collections import OrderedDict
from collections.abc import Sequence
from typing import List, Optional

from . import builtin, dynamic, generator, physical_course, sdf_reader
from .world import World, WorldError

GENERATED = "generated:"
FRESH = "fresh:"  # more worlds of the same recipe, made on the spot
DYNAMIC = "dynamic:"  # rooms with moving obstacles
FORMS = (
    f"generated:N (0-{generator.COUNT - 1}), generated:train, generated:test, generated:validation, generated:learn, "
    "fresh:N, fresh:N-M (0 on), dynamic:N, dynamic:N-M, dynamic:validation, dynamic:test, physical_course, a .world "
    "file or a folder of them"
)
MAX_WORLDS = 10_000  # in a folder


def load(spec: str) -> World:
    """The one world that `spec` names. Raises WorldError with one line."""
    text = str(spec)
    if text.startswith((GENERATED, FRESH, DYNAMIC)):
        names = specs(text)
        if len(names) > 1:
            raise WorldError(f"{text} names {len(names)} worlds where one is needed; give one of them")
        number = int(names[0].split(":")[1])
        if text.startswith(GENERATED):
            return builtin.world(number)
        if text.startswith(DYNAMIC):
            return dynamic.generate(number)
        return dataclasses.replace(generator.generate(generator.COUNT + number), name=names[0])
    if text == physical_course.NAME:
        return physical_course.world()
    if text.endswith(".world"):
        return sdf_reader.read(text)
    if os.path.isdir(text):
        raise WorldError(f"{text} is a folder where one world is needed; give one of its .world files")
    raise WorldError(f"unknown world {text[:200]!r}; give {FORMS}")


def load_all(spec: str) -> List[World]:
    """All worlds that `spec` names, in a fixed order: numbers rise, a folder's files in the order of their numbers."""
    return [load(one) for one in specs(spec)]


class Worlds(Sequence):
    """The worlds of a specification, several with commas between them, as a sequence.

    Files and built-in worlds are loaded at once, so that a wrong one is heard of at the beginning. Fresh worlds are
    generated when they are asked for, since each takes up to a tenth of a second; the last KEPT of them stay.

    Raises:
        WorldError: for a specification or a file that cannot be read.
    """

    KEPT = 256

    def __init__(self, spec: str):
        self.specs = [one for part in spec.split(",") for one in specs(part.strip())]
        self._loaded = {i: load(one) for i, one in enumerate(self.specs) if not one.startswith((FRESH, DYNAMIC))}
        self._fresh: "OrderedDict[int, World]" = OrderedDict()

    def __len__(self) -> int:
        return len(self.specs)

    def __getitem__(self, index):
        """World number `index`, or a list of them for a slice."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        index = range(len(self))[index]
        if index in self._loaded:
            return self._loaded[index]
        if index not in self._fresh:
            self._fresh[index] = load(self.specs[index])
            if len(self._fresh) > self.KEPT:
                self._fresh.popitem(last=False)
        return self._fresh[index]

    def named(self, name: str) -> Optional[World]:
        """The first world called `name`, or None."""
        if name in self.specs:
            return self[self.specs.index(name)]
        return next((world for world in self._loaded.values() if world.name == name), None)


def specs(spec: str) -> List[str]:
    """The specifications of the single worlds that `spec` names, in load_all's order."""
    text = str(spec)
    if text.startswith(GENERATED):
        return [f"{GENERATED}{n}" for n in _numbers(text)]
    if text.startswith(FRESH):
        return [f"{FRESH}{n}" for n in _range(text, FRESH)]
    if text.startswith(DYNAMIC):
        split = dynamic.SPLITS.get(text[len(DYNAMIC) :])
        return [f"{DYNAMIC}{n}" for n in (_range(text, DYNAMIC) if split is None else split)]
    return folder_files(text) if os.path.isdir(text) else [text]


def folder_files(folder: str) -> List[str]:
    """The .world files directly in a folder, by number, then name. WorldError where there is none."""
    try:
        names = [n for n in os.listdir(folder) if n.endswith(".world")]
    except OSError as error:
        raise WorldError(f"{folder} cannot be listed ({error.strerror}); check the path") from None
    if not 1 <= len(names) <= MAX_WORLDS:
        raise WorldError(f"{folder} holds {len(names)} .world files; it must hold 1 to {MAX_WORLDS}")
    return [os.path.join(folder, name) for name in sorted(names, key=_natural)]


def _natural(name: str):
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", name)]


def _range(text: str, form: str) -> List[int]:
    match = re.match(r"^(\d{1,9})(?:-(\d{1,9}))?$", text[len(form) :], re.ASCII)
    first, last = (int(match.group(1)), int(match.group(2) or match.group(1))) if match else (0, -1)
    if not 0 <= last - first < MAX_WORLDS:
        raise WorldError(f"{text[:200]}: give {form}N or {form}N-M, {MAX_WORLDS} worlds at most")
    return list(range(first, last + 1))


def _numbers(text: str) -> List[int]:
    part = text[len(GENERATED) :]
    if part in builtin.SPLITS:
        return list(builtin.SPLITS[part])
    if not re.match(r"^\d{1,9}$", part, re.ASCII) or int(part) >= generator.COUNT:
        raise WorldError(f"world {text[:200]!r} does not exist; give {FORMS}")
    return [int(part)]
