"""Data in the web pages that this package writes."""

import json
import re


def text_of_data(html):
    """Return the JSON text of a page's data."""
    data_element = r'<script type="application/json" id="data">(.*?)</script>'
    (text,) = re.findall(data_element, html, re.DOTALL)
    return text


def data_of(html):
    """Return the data that a page's script draws."""
    return json.loads(text_of_data(html))
