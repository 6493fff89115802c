"""Reads a Gazebo world's XML: bounded in size, without entities; and numbers from its texts. `sdf_reader` uses it."""

from __future__ import annotations

import io
import re
from typing import List, Optional
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import iterparse

from applr_ros1.common import files

from .world import WorldError

MAX_BYTES = 16 * 2**20  # BARN's largest world has .8 MB
MAX_TAGS, MAX_DEPTH = 500_000, 100  # 10,000 obstacles have 140,000 tags, models within models some twenty levels
FAR = 10_000.0  # [m]; nothing in a course lies farther out


def parse(path: str) -> Element:
    """The root element of an SDF file. Anything wrong with it is a WorldError of one line."""
    data = files.read_bytes(path, MAX_BYTES)
    # DynaBARN's boilerplate says <pose frame=>, which Gazebo's parser forgives
    text = io.BytesIO(re.sub(rb"<(\w+) frame=>", rb"<\1>", data))
    tags = depth = 0
    try:
        for event, found in iterparse(text, ("start", "end"), forbid_dtd=True):
            root = found  # the last one to end
            tags, depth = (tags + 1, depth + 1) if event == "start" else (tags, depth - 1)
            if tags > MAX_TAGS or depth > MAX_DEPTH:
                break
    except DefusedXmlException:
        raise WorldError(f"{path} has a DOCTYPE or entities, which are not read; remove them") from None
    except (ParseError, LookupError, ValueError) as error:  # the latter two: an encoding that is unknown or wrong
        raise WorldError(f"{path} is not well-formed XML ({error}); save the world from Gazebo again") from None
    if depth:
        raise WorldError(f"{path} has over {MAX_TAGS} tags, or {MAX_DEPTH} levels of them; give a simpler world")
    return root


def numbers(text: Optional[str], count: int, what: str) -> List[float]:
    """`count` finite numbers within +-FAR from an element's text. `what` names the thing in the error."""
    words = (text or "").split()
    try:
        values = [float(w) for w in words]
    except ValueError:
        values = []
    if len(values) != count or len(words) != count:
        raise WorldError(f"{what} is {_short(text)!r}; it must be {count} number{'s' if count > 1 else ''}")
    for value in values:
        if not abs(value) <= FAR:
            raise WorldError(f"{what} is {_short(text)!r}; its numbers must be finite and within {FAR}")
    return values


def _short(text) -> str:
    text = " ".join((text or "").split())
    return text if len(text) <= 60 else text[:57] + "..."
