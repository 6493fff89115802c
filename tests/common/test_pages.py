"""Tests of the frame of all web pages: data that looks like HTML or like a mark, and the colours of
methods.
"""

import json
import re

from applr_ros1.common.pages.colors import METHOD_COLORS, color_indices
from applr_ros1.common.pages.page import Page


def test_text_and_data_neither_end_a_script_nor_count_as_a_mark(tmp_path):
    script = tmp_path / "script.js"
    script.write_text("D.words;")
    hostile = "</script><!-- <script> @VERDICT@"
    page = Page(
        "kind", "<b>title", hostile, [script], {"words": hostile}, measured=["a < b"]
    ).html()
    source = page.decode()
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', source).group(1)
    assert json.loads(data) == {"words": hostile}
    assert "<!--" not in data
    assert source.count("</script>") == 2
    assert "<b>title" not in source
    assert "a &lt; b" in source


def test_a_number_is_not_parted_from_its_unit(tmp_path):
    script = tmp_path / "script.js"
    script.write_text("")
    page = Page("kind", "title", "Reached in 5.3 s, 6.8 m", [script], {}).html().decode()
    assert "5.3&nbsp;s, 6.8&nbsp;m" in page


def test_a_method_has_the_same_colour_on_each_page_and_no_two_share_one():
    alone = color_indices(["applr"])
    among = color_indices(["mine", "dwa", "static", "other", "applr"])
    assert alone["applr"] == among["applr"]
    assert len(set(among.values())) == len(among)
    assert max(among.values()) < len(METHOD_COLORS)
