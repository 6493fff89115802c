"""Files of the repository outside docs/ as pages of the site, and links from pages to files.

A page of `PAGES` holds one line in docs/; its text is the file's. On every page a link to such a file leads to its
page. A link to any other file or folder of the repository becomes the name alone, since the site has no copy of it, and
one that leads nowhere is a warning.
"""

import posixpath
import re
from pathlib import Path

from sphinx.util import logging

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    "project/contributing": "CONTRIBUTING.md",
    "project/security": "SECURITY.md",
    "project/examples": "examples/README.md",
    "explanation/models/applr": "applr_ros1/models/applr.md",
    "explanation/models/jackal": "applr_ros1/robots/jackal/applr.md",
    "explanation/models/jackal_static": "applr_ros1/robots/jackal/static.md",
    "explanation/models/appld": "applr_ros1/robots/jackal/appld.md",
    "explanation/models/husky_static": "applr_ros1/robots/husky/static.md",
    "explanation/models/waffle_pi_static": "applr_ros1/robots/turtlebot3_waffle_pi/static.md",
}
PAGE_OF = {file: page for page, file in PAGES.items()}
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#:\s]+)(#[^)\s]*)?\)")
log = logging.getLogger(__name__)


def _read(app, page, source):
    """Take the text of a page's file, and turn links to files into links to pages."""
    file = PAGES.get(page, "docs/%s.md" % page)
    text = (ROOT / file).read_text(encoding="utf-8") if page in PAGES else source[0]

    def link(found):
        image, label, target, anchor = found.groups()
        path = posixpath.normpath(posixpath.join(posixpath.dirname(file), target))
        if path in PAGE_OF:
            path = "docs/%s.md" % PAGE_OF[path]
        elif not (ROOT / path).exists():
            log.warning("%s links to %s, which does not exist", file, target, location=page)
        elif not image and (not path.startswith("docs/") or (ROOT / path).is_dir()):
            return label if label.startswith("`") else "%s (`%s`)" % (label, path)
        return "%s[%s](%s%s)" % (image, label, posixpath.relpath(path, "docs/" + posixpath.dirname(page)), anchor or "")

    source[0] = LINK.sub(link, text)


def setup(app):
    """Called by Sphinx."""
    app.connect("source-read", _read)
    return {"parallel_read_safe": True}
