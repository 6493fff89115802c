"""Reads a Gazebo world's XML without trusting it.

Bytes, elements and depth are bounded, there are no entities, and numbers have to be numbers. Only `sdf_reader` uses it.
"""

from __future__ import annotations

import io
import re
from typing import List, Optional
from xml.etree.ElementTree import Element, ParseError

from applr_ros1.common import files

from .world import WorldError

try:
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import iterparse
except ImportError:  # pragma: no cover
    iterparse = None

MAX_BYTES = 16 * 2**20  # BARN's largest world has .8 MB
MAX_ELEMENTS = 400_000  # BARN's largest has 26 thousand
MAX_DEPTH = 64
FAR = 10_000.0  # [m]; nothing in a course lies farther out


def parse(path: str) -> Element:
    """The root element of an SDF file. Anything wrong with it is a WorldError of one line."""
    if iterparse is None:  # pragma: no cover
        raise WorldError("reading %s needs defusedxml; install python3-defusedxml (apt) or defusedxml (pip)" % path)
    data = files.read_bytes(path, MAX_BYTES, WorldError)
    try:
        return _bounded_tree(path, data)
    except ParseError as error:
        # DynaBARN's boilerplate says <pose frame=>, which Gazebo's parser forgives
        mended = re.sub(rb"<(\w+) frame=>", rb"<\1>", data)
        if mended == data:
            raise _not_xml(path, error) from None
    try:
        return _bounded_tree(path, mended)
    except ParseError as error:
        raise _not_xml(path, error) from None


def _not_xml(path: str, error) -> WorldError:
    return WorldError("%s is not well-formed XML (%s); save the world from Gazebo again" % (path, _line(error)))


def _bounded_tree(path: str, data: bytes) -> Element:
    depth = count = 0
    root = None
    try:
        for event, element in iterparse(io.BytesIO(data), events=("start", "end"), forbid_dtd=True):
            if event == "end":
                depth -= 1
                continue
            root = element if root is None else root
            depth, count = depth + 1, count + 1
            if depth > MAX_DEPTH or count > MAX_ELEMENTS:
                raise WorldError(
                    "%s nests %d deep or has %d elements, more than a world needs (%d, %d); simplify it"
                    % (path, depth, count, MAX_DEPTH, MAX_ELEMENTS)
                )
    except DefusedXmlException as error:
        raise WorldError(
            "%s uses XML that is not read, %s; remove its DOCTYPE and entities" % (path, type(error).__name__)
        ) from None
    except (LookupError, UnicodeError) as error:  # an encoding that does not exist or does not fit
        raise WorldError(
            "%s has an encoding that cannot be read (%s); save it as UTF-8" % (path, _line(error))
        ) from None
    if root is None:
        raise WorldError("%s is empty; save the world from Gazebo again" % path)
    return root


def _line(error) -> str:
    return " ".join(str(error).split())


def numbers(text: Optional[str], count: int, what: str) -> List[float]:
    """`count` finite numbers within +-FAR from an element's text. `what` names the thing in the error."""
    words = (text or "").split()
    try:
        values = [float(w) for w in words]
    except ValueError:
        values = []
    if len(values) != count or len(words) != count:
        raise WorldError("%s is %r; it must be %d number%s" % (what, _short(text), count, "s" if count > 1 else ""))
    for value in values:
        if not abs(value) <= FAR:
            raise WorldError("%s is %r; its numbers must be finite and within %d" % (what, _short(text), FAR))
    return values


def _short(text) -> str:
    text = " ".join((text or "").split())
    return text if len(text) <= 60 else text[:57] + "..."
