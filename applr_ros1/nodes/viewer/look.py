"""Look of the viewer's page: viser's page in the colours and type of all pages, light or dark."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Tuple

from applr_ros1.common.files import read_bytes
from applr_ros1.common.pages.colors import COLORS, css
from applr_ros1.common.pages.page import PAGES

STYLE = Path(__file__).with_name("look.css")
SCRIPT = Path(__file__).with_name("look.js")
# Colours of trajectories of low and of high cost, which are seen on black and on white
CHEAP = "cheap"
DEAR = "obstacle"


def dressed(page: bytes, title: str) -> bytes:
    """Return viser's page with a title, and with the style and the scheme of all pages."""
    stylesheets = (css(), read_bytes(PAGES / "words.css").decode(), read_bytes(STYLE).decode())
    # A page must say its encoding in its first kilobyte.
    head = f'<head><meta charset="utf-8"><title>{html.escape(title)}</title>'
    head += f"<script>{read_bytes(SCRIPT).decode()}</script>"
    for stylesheet in stylesheets:
        head += f"<style>{stylesheet}</style>"
    return page.replace(b"<head>", head.encode(), 1)


def legend(*entries: Tuple[str, str, str]) -> str:
    """Return a legend of the scene as HTML.

    A scene has the colours of light pages in dark ones, too.

    Args:
        entries: Class of the swatch (words.css), name of its colour (colors.py), and words.
    """
    items = []
    for swatch_class, color_name, words in entries:
        swatch_style = f"--swatch: {COLORS[color_name].light}"
        swatch = f'<span class="swatch {swatch_class}" style="{swatch_style}"></span>'
        items.append(f"<li>{swatch}{words}</li>")
    cost_style = f"--cheap: {COLORS[CHEAP].light}; --dear: {COLORS[DEAR].light}"
    return f'<ul class="legend" style="{cost_style}">{"".join(items)}</ul>'
