"""Files are written whole or not at all and read with a bound; what goes wrong is a StorageError of one line."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import Counter
from pathlib import Path
from typing import Any, Dict, List, Tuple

from applr_ros1.common.errors import ApplrError, reason

MAX_BYTES = 2**31  # of a file that is read where the caller knows no smaller bound
MAX_JSON_BYTES = 2**28
MAX_CELLS = 16_000_000  # of one map, 200 x 200 m at .05 m; a larger one is refused instead of filling the memory


class StorageError(ApplrError):
    """A file or folder that cannot be read or written."""


def _check_regular(path) -> None:
    """Refuse all but regular files: reading a pipe would wait for ever, renaming over a device would remove it."""
    if os.path.lexists(path) and not os.path.isfile(path):
        raise StorageError(f"{path}: a folder, pipe or device; give the path of a regular file")


def write_bytes(path, data: bytes) -> None:
    """Writes beside the file, flushes to disk, renames: a crash leaves the old file or the new one, never a part."""
    _check_regular(path)
    partial = f"{path}.{os.getpid()}.partial"
    try:
        with open(partial, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as problem:
        if os.path.exists(partial):
            os.unlink(partial)
        raise StorageError(f"{path}: cannot be written ({reason(problem)}); the file there is untouched") from None


def write_json(path, value: Any) -> None:
    """Writes a value as JSON that a person can read, as `write_bytes` does."""
    write_bytes(path, (json.dumps(value, indent=1) + "\n").encode())


def read_bytes(path, limit: int = MAX_BYTES) -> bytes:
    """Return the content of a regular file of at most `limit` bytes. Pipes, devices and folders are refused at once."""
    _check_regular(path)
    try:
        if os.path.getsize(path) > limit:
            raise StorageError(f"{path}: more than {limit} bytes are too many; give another file")
        return Path(path).read_bytes()
    except OSError as problem:
        raise StorageError(f"{path}: cannot be read ({reason(problem)}); give an existing file") from None


def read_json(path, limit: int = MAX_JSON_BYTES) -> Any:
    """Return the value in a JSON file."""
    try:
        return json_value(read_bytes(path, limit))
    except ApplrError:
        raise
    except ValueError as problem:
        raise StorageError(f"{path}: not JSON ({reason(problem)}); the file is damaged or of another kind") from None


def json_value(text) -> Any:
    """Return the value of a JSON text; ValueError also where it is too deep, beyond a float, or has a name twice."""
    try:
        return json.loads(text, parse_int=whole_number, object_pairs_hook=_with_each_name_once)
    except RecursionError:
        raise ValueError("nested too deep") from None


def _with_each_name_once(members: List[Tuple[str, Any]]) -> Dict[str, Any]:
    found = dict(members)
    if len(found) < len(members):
        raise ValueError(f"it has {Counter(name for name, _ in members).most_common(1)[0][0][:60]!r} twice")
    return found


def whole_number(text: Any) -> int:
    """Return the int of a text; ValueError where no float holds it."""
    number = int(text)
    try:
        float(number)
    except OverflowError:
        raise ValueError("a whole number of over 308 digits") from None
    return number


def plain_xml(data: bytes) -> str:
    """XML as TinyXML takes it: with anything before the declaration and in comments, a bare &, no name spaces."""
    first, *others = data.decode("utf-8-sig", "replace").split("<!--")
    parts = (part.partition("-->") for part in others)
    text = first + "".join("\n" * comment.count("\n") + rest for comment, _, rest in parts)
    text = re.sub(r"&(?!#?\w+;)", "&amp;", re.sub(r"""\sxmlns\s*=\s*("[^"<>]*"|'[^'<>]*')""", "", text))
    bound = set(re.findall(r"\bxmlns:([\w.-]+)", text))
    text = re.sub(r"(</?)([\w.-]+):(?=\w)", lambda tag: tag[0] if tag[2] in bound else f"{tag[1]}{tag[2]}_", text)
    return re.sub(r"<\?xml\b[^<>]*>", "", text, count=1).lstrip()


def check_tables(database: Any, name) -> None:
    """Raise StorageError for an open sqlite3 database of a stranger that has more than tables.

    Reading a view, a calculated column, or the check of an expression can be endless work.
    """
    for kind, sql in database.execute("SELECT type, sql FROM sqlite_master WHERE sql IS NOT NULL"):
        plain = not re.search(r"\b(as|check|virtual)\b", sql, re.IGNORECASE)
        if not plain or kind not in ("table", "index") or (kind == "index" and sql.count("(") > 1):
            raise StorageError(f"{name}: it has more than plain tables ({sql[:60]!r}); give another file")


def sha256(*values: Any) -> str:
    """Return the checksum, in hexadecimal digits, of values one after the other: bytes, or others by their text."""
    return hashlib.sha256(b"\0".join(v if isinstance(v, bytes) else str(v).encode() for v in values)).hexdigest()
