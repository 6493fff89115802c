"""Tests of the frame of all web pages: data that looks like HTML or like a mark, and the colours of
methods.
"""

import json

from applr_ros1.common.pages.colors import METHOD_COLORS, color_indices
from applr_ros1.common.pages.page import Page
from tests.support.browser import needs_browser, opened
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


@needs_browser
def test_the_words_of_a_scale_are_readable_over_obstacles(tmp_path):
    # Given: a map that is red all over
    script = tmp_path / "script.js"
    script.write_text(
        """
        const paint = view => {
          view.c.fillStyle = "#ff0000";
          view.c.fillRect(0, 0, 4, 4);
        };
        const view = new TopView(content, [0, 0, 4, 4], paint, "map");
        """
    )
    page_file = tmp_path / "page.html"
    page_file.write_bytes(Page("kind", "title", "verdict", [script], {}).html())
    # Then: there is little red around the words, above the left end of the scale
    with opened(page_file) as page:
        page.wait_for_function("view.scale > 0")
        red = page.evaluate("view.c.getImageData(14, Math.round(view.tall) - 28, 1, 1).data[0]")
    assert red < 100


def test_a_method_has_the_same_colour_on_each_page_and_no_two_share_one():
    indices_alone = color_indices(["applr"])
    indices_of_five = color_indices(["mine", "dwa", "static", "other", "applr"])
    assert indices_alone["applr"] == indices_of_five["applr"]
    assert len(set(indices_of_five.values())) == len(indices_of_five)
    assert max(indices_of_five.values()) < len(METHOD_COLORS)
