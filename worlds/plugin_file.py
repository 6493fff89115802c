"""A compiled Gazebo plugin (ELF shared object, x86-64): bytes at addresses, and the names of called functions.

`plugin_frames` reads the code through it; nothing in the file is executed.
The format is read here with `struct`: pyelftools builds tables of whatever size a file states, and this must stay cheap
on a hostile file.
"""

from __future__ import annotations

import struct
from typing import Dict, List, NamedTuple, Optional, Tuple

from applr_ros1.common import files

from .world import WorldError

MAX_BYTES = 16 * 2**20  # DynaBARN's plugins have .2 MB
MAX_SECTIONS = 200
MAX_ENTRIES = 100_000  # symbols or relocations of one section
MAX_NAME = 8192  # characters; C++ symbols of Boost are long
X86_64, SHARED_OBJECT = 62, 3
SYMBOLS, RELOCATIONS, NO_CONTENT, DYNAMIC_SYMBOLS = 2, 4, 8, 11  # sh_type
WRITABLE, LOADED, EXECUTABLE = 1, 2, 4  # sh_flags
FUNCTION = 2  # symbol type


class PluginError(WorldError):
    """A plugin is not understood. One line: which file and why."""


class _Section(NamedTuple):
    name: int
    kind: int
    flags: int
    address: int
    offset: int
    size: int
    link: int
    info: int
    alignment: int
    entry_size: int


class _Symbol(NamedTuple):
    name: int
    info: int
    other: int
    section: int
    value: int
    size: int


class PluginFile:
    """The loaded image of a shared object. Raises PluginError or WorldError where the file cannot be read.

    code       [(address, bytes), ...] of the executable sections
    functions  {address: (name, size in bytes)} of the functions that the file defines
    """

    def __init__(self, path: str):
        self.path = path
        self._data = files.read_bytes(path, MAX_BYTES, WorldError)
        self.code: List[Tuple[int, bytes]] = []
        self.functions: Dict[int, Tuple[str, int]] = {}
        self._constants: List[Tuple[int, bytes]] = []  # loaded sections that are never written
        self._slots: Dict[int, str] = {}  # addresses of the global offset table's entries: symbols
        try:
            self._read()
        except struct.error:
            raise PluginError("%s is cut short; copy it again" % path) from None

    def _read(self) -> None:
        data = self._data
        if data[:6] != b"\x7fELF\x02\x01":
            raise PluginError("%s is no 64-bit shared object (ELF); give the compiled plugin" % self.path)
        kind, machine = struct.unpack_from("<HH", data, 16)
        if (kind, machine) != (SHARED_OBJECT, X86_64):
            raise PluginError("%s is no shared object for x86-64; give the compiled plugin" % self.path)
        (table,) = struct.unpack_from("<Q", data, 40)
        entry_size, count, _ = struct.unpack_from("<HHH", data, 58)
        if entry_size != 64 or not 0 < count <= MAX_SECTIONS:
            raise PluginError("%s has %d sections; a plugin has 1 to %d" % (self.path, count, MAX_SECTIONS))
        if table + 64 * count > len(data):
            raise PluginError("%s is cut short; copy it again" % self.path)
        sections = [_Section(*struct.unpack_from("<IIQQQQIIQQ", data, table + 64 * n)) for n in range(count)]
        for section in sections:
            content = self._content(section)
            if section.flags & LOADED and content:
                if section.flags & EXECUTABLE:
                    self.code.append((section.address, content))
                if not section.flags & WRITABLE:
                    self._constants.append((section.address, content))
            if section.kind in (SYMBOLS, DYNAMIC_SYMBOLS):
                for symbol, name in self._symbols(sections, section):
                    if symbol.info & 15 == FUNCTION and symbol.section:
                        self.functions[symbol.value] = (name, symbol.size)
        for section in sections:
            if section.kind == RELOCATIONS and section.flags & LOADED and 0 < section.link < count:
                symbols = self._symbols(sections, sections[section.link])
                for slot, info, _ in self._entries(section, "<QQq"):
                    if 0 < info >> 32 < len(symbols):
                        self._slots[slot] = symbols[info >> 32][1]

    def _content(self, section: _Section) -> bytes:
        if section.kind == NO_CONTENT:
            return b""
        if section.offset + section.size > len(self._data):
            raise PluginError("%s is cut short; copy it again" % self.path)
        return self._data[section.offset : section.offset + section.size]

    def _entries(self, section: _Section, layout: str) -> List[tuple]:
        size = struct.calcsize(layout)
        content = self._content(section)
        if len(content) > size * MAX_ENTRIES:
            raise PluginError("%s has more than %d symbols; a plugin has fewer" % (self.path, MAX_ENTRIES))
        return list(struct.iter_unpack(layout, content[: len(content) // size * size]))

    def _symbols(self, sections: List[_Section], section: _Section) -> List[Tuple[_Symbol, str]]:
        names = self._content(sections[section.link]) if section.link < len(sections) else b""
        symbols = [_Symbol(*entry) for entry in self._entries(section, "<IBBHQQ")]
        return [(symbol, _text(names, symbol.name)) for symbol in symbols]

    def constant(self, address: int, size: int) -> Optional[bytes]:
        """`size` bytes at an address that the program never writes; None where there are none."""
        for start, content in self._constants:
            if start <= address and address + size <= start + len(content):
                return content[address - start : address - start + size]
        return None

    def slot(self, address: int) -> str:
        """The symbol whose address the loader puts at `address`, or ""."""
        return self._slots.get(address, "")


def _text(names: bytes, offset: int) -> str:
    end = names.find(b"\0", offset, offset + MAX_NAME)
    return names[offset:end].decode("ascii", "replace") if end >= 0 else ""
