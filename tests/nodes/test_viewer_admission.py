"""Tests of the viewer's refusals, without a server. tests/live/test_viewer.py has the server's."""

import pytest

from applr_ros1.nodes.viewer.admission import refusal

TOKEN = "secret"
NO_TOKEN = "the address lacks the token: use the address that the viewer prints"
OTHER_WEBSITE = "a page of another website may not use this page"


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8080", "192.168.1.5", "[::1]:8080", "[::1]", "LocalHost:8080"]
)
def test_addresses_and_localhost_are_admitted_with_the_token(host):
    # Programs other than browsers send no origin.
    assert refusal("/secret", {"Host": host}, TOKEN) is None
    assert refusal("/secret", {"Host": host, "Origin": f"http://{host}"}, TOKEN) is None


@pytest.mark.parametrize("path", ["/secret/", "/secret?x=1", "/secret/index.html"])
def test_what_follows_the_token_is_admitted(path):
    assert refusal(path, {"Host": "localhost:8080"}, TOKEN) is None


@pytest.mark.parametrize(
    "path",
    ["/", "/?secret", "/secrets", "/secre", "/x/secret", "/Secret", "/s\u00e9cret", "/\udcff"],
)
def test_a_path_that_does_not_begin_with_the_token_is_refused(path):
    assert refusal(path, {"Host": "localhost:8080"}, TOKEN) == NO_TOKEN


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "http://localhost:8081",  # another server of this computer
        "http://localhost:8080.evil.example",
        "null",  # a page in a sandboxed frame
        "",
    ],
)
def test_a_page_of_another_origin_is_refused_with_the_token(origin):
    headers = {"Host": "localhost:8080", "Origin": origin}
    assert refusal("/secret", headers, TOKEN) == OTHER_WEBSITE


@pytest.mark.parametrize(
    "host", ["evil.example:8080", "localhost.evil.example", "127.0.0.1.nip.io"]
)
def test_a_name_that_could_be_made_to_lead_to_this_computer_is_refused(host):
    headers = {"Host": host, "Origin": f"http://{host}"}
    name = host.split(":")[0]
    advice = "open the page by its address, such as 127.0.0.1"
    reason = refusal("/secret", headers, TOKEN)
    assert reason == f"{name!r} is not a name of this computer: {advice}"


def test_a_request_without_a_host_is_refused():
    assert refusal("/secret", {}, TOKEN).startswith("'' is not a name of this computer")
