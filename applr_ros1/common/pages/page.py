"""Frame of all web pages: title, verdict in a sentence, content, and how it was measured.

A page is one file that needs no network. Its style and its charts are in page.css and page.js. The
script of each kind of page draws the content from the page's data.
"""

from __future__ import annotations

import html
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Sequence

from applr_ros1.common.files import read_bytes

HERE = Path(__file__).parent
# Colours of methods on light and dark pages, after Okabe and Ito. Vermilion is kept for failures.
METHOD_COLORS = (
    ("#4a4a4a", "#c8c8c8"),
    ("#009e73", "#1fbf8f"),
    ("#0072b2", "#3d9be0"),
    ("#b8578e", "#cc79a7"),
    ("#b57c00", "#e69f00"),
    ("#8a8300", "#f0e442"),
)
FIXED = {"dwa": 0, "applr": 1, "static": 2}  # colours of the methods that this package ships


def color_indices(methods: Sequence[str]) -> Dict[str, int]:
    """Return the index of each method's colour in METHOD_COLORS, the same on every page."""
    free = [index for index in range(len(METHOD_COLORS)) if index not in FIXED.values()]
    others = [method for method in methods if method not in FIXED]
    indices = {method: free[n % len(free)] for n, method in enumerate(others)}
    for method in methods:
        indices.setdefault(method, FIXED.get(method, 0))
    return indices


@dataclass
class Page:
    """Web page in one file.

    Attributes:
        kind: What the page is about, beside the package's name.
        title: Title, in plain text.
        verdict: What the page says, in a sentence.
        script: Script that draws the content. It finds `data` as D and the functions of page.js.
        data: JSON values for the script.
        body: HTML above what the script draws.
        measured: Sentences that say how it was measured.
    """

    kind: str
    title: str
    verdict: str
    script: Path
    data: Any
    body: str = ""
    measured: Sequence[str] = ()

    def html(self) -> bytes:
        """Return the page, encoded in UTF-8."""
        data = json.dumps(self.data, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
        parts = {
            "TITLE": html.escape(self.title),
            "KIND": html.escape(self.kind),
            # A number is not parted from its unit at the end of a line.
            "VERDICT": re.sub(r"(\d) (m|s)\b", "\\1&nbsp;\\2", html.escape(self.verdict)),
            "BODY": self.body,
            "MEASURED": _folded(self.measured),
            "PALETTE": _palette(),
            "STYLE": _text("page.css"),
            "SHARED": _text("page.js"),
            "SCRIPT": read_bytes(self.script).decode(),
            # A string in the data must not end the script.
            "DATA": data.replace("</", "<\\/").replace("<!--", "<\\u0021--"),
        }
        # All marks are replaced in one pass, so that a mark within the data stays as it is.
        page = re.sub("@([A-Z]+)@", lambda mark: parts[mark.group(1)], _text("page.html"))
        return page.encode()


def _text(name: str) -> str:
    return read_bytes(HERE / name).decode()


def _folded(sentences: Sequence[str]) -> str:
    """Return HTML that says how it was measured."""
    if not sentences:
        return ""
    paragraphs = "".join(f"<p>{html.escape(sentence)}</p>" for sentence in sentences)
    return f"<details><summary>How it was measured</summary>{paragraphs}</details>"


def _palette() -> str:
    """Return the colours of the methods as CSS."""
    schemes: List[str] = []
    for scheme in zip(*METHOD_COLORS):
        colors = [f"--method-{index}: {color};" for index, color in enumerate(scheme)]
        schemes.append(":root { " + " ".join(colors) + " }")
    light, dark = schemes
    return f"{light}\n@media (prefers-color-scheme: dark) {{ {dark} }}"
