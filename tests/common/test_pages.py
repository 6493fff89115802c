"""Tests of the frame of all web pages: data that looks like HTML or like a mark, and the colours of
methods.
"""

import json

from applr_ros1.common.pages.colors import METHOD_COLORS, color_indices
from applr_ros1.common.pages.page import Page
from tests.support.pages import text_of_data


def test_text_and_data_neither_end_a_script_nor_count_as_a_mark(tmp_path):
    script = tmp_path / "script.js"
    script.write_text("D.words;")
    # It would end the script, begin a comment, and be replaced as a mark of the frame.
    hostile_text = "</script><!-- <script> @VERDICT@"
    page = Page(
        "kind",
        "<b>title",
        hostile_text,
        [script],
        {"words": hostile_text},
        measured=["a < b"],
    )
    html = page.html().decode()
    data_text = text_of_data(html)
    assert json.loads(data_text) == {"words": hostile_text}
    assert "<!--" not in data_text
    # Those of the data and of the page's own script
    assert html.count("</script>") == 2
    assert "<b>title" not in html
    assert "a &lt; b" in html


def test_a_number_is_not_parted_from_its_unit(tmp_path):
    script = tmp_path / "script.js"
    script.write_text("")
    page = Page("kind", "title", "Reached in 5.3 s, 6.8 m", [script], {})
    assert "5.3&nbsp;s, 6.8&nbsp;m" in page.html().decode()


def test_a_method_has_the_same_colour_on_each_page_and_no_two_share_one():
    indices_alone = color_indices(["applr"])
    indices_of_five = color_indices(["mine", "dwa", "static", "other", "applr"])
    assert indices_alone["applr"] == indices_of_five["applr"]
    assert len(set(indices_of_five.values())) == len(indices_of_five)
    assert max(indices_of_five.values()) < len(METHOD_COLORS)
