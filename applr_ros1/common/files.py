"""Atomic writing, reading and hashing of files. Every failure is an ApplrError of one line."""

from __future__ import annotations

import hashlib
import json
import os
import re
import traceback
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, Dict, Iterator
from xml.etree.ElementTree import ParseError

import yaml

from applr_ros1.common.errors import ApplrError, reason

DAMAGED = "the file is damaged or of another kind"
PARTIAL = ".partial"  # end of the name of a file that is not complete
DEEPEST_LEVEL = 50  # largest number of levels of a YAML file; parameter files have about five
MOST_VALUES = 100_000  # largest number of values of a YAML file, with those of each alias

# what TinyXML accepts although it is not XML
NAMESPACE = re.compile(r"""\sxmlns\s*=\s*("[^"<>]*"|'[^'<>]*')""")  # a default namespace
DECLARATION = re.compile(r"<\?xml\b[^<>]*>")


class FileError(ApplrError):
    """Error of a file. Its message begins with the path of the file."""


@contextmanager
def reading(path: Any, remedy: str = DAMAGED) -> Iterator[None]:
    """Convert every error of the block that reads a file to a FileError of one line.

    Whatever a reader raises for a damaged file is an error of the file. APPLR_DEBUG shows the
    traceback, in case it is an error of the reader. Blocks may be nested: the innermost file is
    named.

    Args:
        path: Path of the file.
        remedy: What to do about a file that its reader does not understand.
    """
    try:
        yield
    except (FileError, MemoryError, ImportError):  # A missing package is no error of the file.
        raise
    except ApplrError as error:
        raise FileError(f"{path}: {error}") from error
    except Exception as error:
        if getattr(error, "strerror", None):  # from the operating system
            failure = f"cannot be read ({reason(error)}); give an existing file"
        else:
            # The words of other libraries do not help a user, but a place in a text does.
            failure = f"cannot be read{_place(error)}; {remedy}"
            if os.environ.get("APPLR_DEBUG"):  # The caller may go on without the file.
                traceback.print_exc()
        raise FileError(f"{path}: {failure}") from error


def _place(error: Exception) -> str:
    """Return in brackets where a parser of texts failed, or "" for any other error."""
    if isinstance(error, json.JSONDecodeError):
        return f" (line {error.lineno}, column {error.colno})"
    if isinstance(error, ParseError):
        line, column = error.position
        return f" (line {line}, column {column + 1})"
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark:
        return f" (line {error.problem_mark.line + 1}, column {error.problem_mark.column + 1})"
    return ""


def write_bytes(path: Any, data: bytes) -> None:
    """Write a file atomically: a crash leaves the old file or the new one, never a partial one."""
    with written_whole(path) as file:
        file.write(data)


@contextmanager
def written_whole(path: Any) -> Iterator[BinaryIO]:
    """Open a file to write that has a temporary name until the block has ended.

    A crash leaves the old file or the new one, never a partial one. An error of the block leaves
    the old one, too; one of the operating system becomes an ApplrError of one line.
    """
    if os.path.lexists(path) and not os.path.isfile(path):  # Renaming would replace a device.
        raise ApplrError(f"{path}: a folder, pipe or device; give the path of a regular file")
    partial_path = f"{path}.{os.getpid()}{PARTIAL}"
    try:
        # A process that was killed may have left a file of this name. A link or pipe that somebody
        # put there must not be opened: only a new file is.
        if os.path.lexists(partial_path):
            os.unlink(partial_path)
        with open(partial_path, "xb") as partial_file:
            yield partial_file
            # Without fsync, a power failure after the renaming could leave an empty file.
            partial_file.flush()
            os.fsync(partial_file.fileno())
        os.replace(partial_path, path)
    except BaseException as problem:
        with suppress(OSError):
            os.unlink(partial_path)
        if not isinstance(problem, OSError):
            raise
        failure = f"cannot be written ({reason(problem)})"
        if os.path.exists(path):
            failure += "; the file there is untouched"
        raise ApplrError(f"{path}: {failure}") from None


def is_in_writable_folder(path: Any) -> bool:
    """Return whether the folder of a file exists and can be written.

    Asked before work of minutes, whose result could not be written.
    """
    folder = os.path.dirname(os.path.abspath(path))
    return os.path.isdir(folder) and os.access(folder, os.W_OK)


def write_json(path: Any, value: Any) -> None:
    """Write a value as indented JSON, atomically."""
    json_text = json.dumps(value, indent=1) + "\n"
    write_bytes(path, json_text.encode())


def check_regular(path: Any) -> None:
    """Raise FileError if a path is that of a pipe or device, whose reading might never end."""
    if os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path):
        raise FileError(f"{path}: a pipe or device; give the path of a regular file")


def read_bytes(path: Any) -> bytes:
    """Return the content of a regular file."""
    check_regular(path)
    with reading(path):
        return Path(path).read_bytes()


def read_json(path: Any) -> Any:
    """Return the value in a JSON file."""
    with reading(path):
        return json.loads(read_bytes(path))


class LimitedLoader(yaml.SafeLoader):
    """YAML loader of plain values that refuses files with too many values or levels.

    Aliases of aliases can stand for more values than fit into memory, and the time of PyYAML
    increases with the square of the number of levels.
    """

    def __init__(self, stream: Any) -> None:
        super().__init__(stream)
        self._level = 0
        self._value_count = 0
        self._counts: Dict[yaml.Node, int] = {}  # number of values in each node

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose the next node, and count its values."""
        is_alias = self.check_event(yaml.AliasEvent)
        count_before = self._value_count
        self._level += 1
        if self._level > DEEPEST_LEVEL:
            raise ApplrError(f"the file has more than {DEEPEST_LEVEL} levels; remove brackets")
        node: Any = super().compose_node(parent, index)
        self._level -= 1

        if is_alias and node not in self._counts:
            raise ApplrError("the file has an alias inside its own anchor; write the value out")
        self._value_count += self._counts[node] if is_alias else 1
        if self._value_count > MOST_VALUES:
            raise ApplrError(f"the file has more than {MOST_VALUES} values; give a shorter one")
        self._counts.setdefault(node, self._value_count - count_before)
        return node


def read_yaml(path: Any) -> Any:
    """Return the plain value in a YAML file. A tag that creates a Python object is an error."""
    return yaml_value(read_bytes(path), path)


def yaml_value(text: Any, name: Any, loader: Any = LimitedLoader) -> Any:
    """Return the value of a YAML text.

    Raises FileError if it is invalid; the line begins with `name`.
    """
    with reading(name):
        try:
            return yaml.load(text, loader)
        except yaml.scanner.ScannerError as error:
            if "'\\t'" not in str(error.problem):
                raise
            raise ApplrError(f"a tab{_place(error)}: give blanks instead") from error


def plain_xml(data: bytes) -> str:
    """Return XML that TinyXML accepts as standard XML.

    TinyXML allows any text before the declaration and in comments, and ignores name spaces.
    """
    xml_text = NAMESPACE.sub("", _without_comments(data.decode("utf-8-sig", "replace")))
    return DECLARATION.sub("", xml_text, count=1).lstrip()


def _without_comments(text: str) -> str:
    """Return XML without comments, with their line breaks, so that errors name the right line."""
    kept_text, *remaining_parts = text.split("<!--")
    for remaining_part in remaining_parts:
        comment, _, following_text = remaining_part.partition("-->")
        kept_text += "\n" * comment.count("\n") + following_text
    return kept_text


def sha256(*values: Any) -> str:
    """Return the hexadecimal SHA-256 of the values in order.

    Bytes are hashed as they are, other values as text.
    """
    encoded_values = []
    for value in values:
        if not isinstance(value, bytes):
            value = str(value).encode()
        encoded_values.append(value)
    return hashlib.sha256(b"\0".join(encoded_values)).hexdigest()
