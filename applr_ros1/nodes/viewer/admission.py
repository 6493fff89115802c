"""Admission to the page: for whoever knows its address, which ends in a random token, under a name of this computer.

A browser names the page that a request comes from (Origin) and the name by which it found this computer (Host). Another
website's page has another origin, and one whose own name was pointed at this computer (DNS rebinding) has that name.
"""

from __future__ import annotations

import contextlib
import hmac
import ipaddress
import os
import re
import secrets
from http import HTTPStatus
from typing import Any, Iterator, Mapping, Optional

TOKEN = "APPLR_VIEWER_TOKEN"  # environment variable that sets the token


def token() -> str:
    """Return the token that the environment sets, otherwise a new one."""
    return os.environ.get(TOKEN) or secrets.token_urlsafe(16)


def refusal(path: str, headers: Mapping[str, str], token: str) -> Optional[str]:
    """Return why a request is refused, or None if it is admitted."""
    given = headers.get("Host", "")
    name = re.sub(r":\d*$", "", given).strip("[]").lower()
    try:
        ipaddress.ip_address(name)  # nobody can point an address elsewhere
    except ValueError:
        if name != "localhost":
            return f"{name!r} is no name of this computer: open the page by its address, such as 127.0.0.1"
    if "Origin" in headers and headers["Origin"].partition("://")[2] != given:
        return "a page of another website may not use this one"
    if not hmac.compare_digest(re.split("[/?]", path.lstrip("/"))[0].encode(errors="replace"), token.encode()):
        return "the address lacks the token: take the one that the viewer prints"
    return None


@contextlib.contextmanager
def guarded(token: str) -> Iterator[None]:
    """A context in which a viser server is started that answers no request without asking `refusal`."""
    # viser 1.1.1 (requirements/viewer.txt) has no way to refuse a request. It serves with this function of websockets,
    # whose process_request has one; tests/live/test_viewer.py fails where another version serves otherwise.
    from websockets.asyncio import server

    serve = server.serve

    def serve_guarded(*where: Any, process_request: Any, **options: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            reason = refusal(request.path, request.headers, token)
            if reason:
                return connection.respond(HTTPStatus.FORBIDDEN, reason + "\n")
            request.path = request.path.replace("/" + token, "", 1) or "/"
            return process_request(connection, request)

        return serve(*where, process_request=process, **options)

    server.serve = serve_guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]
