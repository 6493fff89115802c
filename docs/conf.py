"""Configuration of the documentation site. `./applr docs` builds it into docs/_build."""

import logging
import sys
import xml.etree.ElementTree as xml
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_ext")]

logging.getLogger("rospy").setLevel(logging.WARNING)  # autodoc imports nodes
logging.getLogger("applr_ros1").setLevel(logging.WARNING)  # the site's style logs what others do
project = "applr_ros1"
author = "applr_ros1 contributors"
copyright = "applr_ros1 contributors, MIT licence"  # noqa: A001 (the name that Sphinx reads)
release = xml.parse(HERE.parent / "package.xml").findtext("version")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "from_code"]
exclude_patterns = ["_build", "_ext"]
nitpicky = True
nitpick_ignore_regex = [("py:.*", ".*")]  # types that docstrings name are no links

myst_enable_extensions = ["colon_fence", "deflist", "attrs_inline"]
myst_heading_anchors = 4

autodoc_typehints = "none"
autodoc_preserve_defaults = True
napoleon_use_rtype = False

highlight_language = "text"
smartquotes_action = "q"  # quotes alone: --option is no dash

html_theme = "furo"
html_title = "applr_ros1"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sphinx = False
