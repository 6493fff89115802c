"""Frame of all web pages: title, verdict in a sentence, content, and how it was measured.

A page is one file that needs no network. Its colours are in colors.py, its style in words.css
and page.css, its charts in page.js. The scripts of each kind of page draw the content from the
page's data.
"""

from __future__ import annotations

import html
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Sequence

from applr_ros1.common.files import read_bytes
from applr_ros1.common.pages.colors import css

PAGES = Path(__file__).parent  # folder of the style and the charts


@dataclass
class Page:
    """Web page in one file.

    Attributes:
        kind: What the page is about, beside the package's name.
        title: Title, in plain text.
        verdict: What the page says, in a sentence.
        scripts: Scripts that draw the content, one after the other. They find `data` as D and the
            functions of page.js.
        data: JSON values for the script.
        body: HTML above what the script draws.
        measured: Sentences that say how it was measured.
    """

    kind: str
    title: str
    verdict: str
    scripts: Sequence[Path]
    data: Any
    body: str = ""
    measured: Sequence[str] = ()

    def html(self) -> bytes:
        """Return the page, encoded in UTF-8."""
        json_data = json.dumps(
            self.data, separators=(",", ":"), ensure_ascii=False, allow_nan=False
        )
        replacements = {
            "TITLE": html.escape(self.title),
            "KIND": html.escape(self.kind),
            # A number is not parted from its unit at the end of a line.
            "VERDICT": re.sub(r"(\d) (m|s)\b", "\\1&nbsp;\\2", html.escape(self.verdict)),
            "BODY": self.body,
            "MEASURED": _folded(self.measured),
            "COLORS": css(),
            "WORDS": _text("words.css"),
            "STYLE": _text("page.css"),
            "SHARED": _text("page.js"),
            "SCRIPTS": "\n".join(read_bytes(script).decode() for script in self.scripts),
            # A string in the data must not end the script.
            "DATA": json_data.replace("</", "<\\/").replace("<!--", "<\\u0021--"),
        }
        # All marks are replaced in one pass, so that a mark within the data stays as it is.
        page_html = re.sub(
            "@([A-Z]+)@", lambda mark: replacements[mark.group(1)], _text("page.html")
        )
        # Names of files need not be UTF-8.
        return page_html.encode(errors="replace")


def _text(name: str) -> str:
    return read_bytes(PAGES / name).decode()


def _folded(sentences: Sequence[str]) -> str:
    """Return HTML that says how it was measured."""
    if not sentences:
        return ""
    paragraphs = "".join(f"<p>{html.escape(sentence)}</p>" for sentence in sentences)
    return f"<details><summary>How it was measured</summary>{paragraphs}</details>"
