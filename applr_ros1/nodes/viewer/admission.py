"""Access control of the page: a request needs the random token in the page's address and a local host name.

A browser sends the origin of the page that makes a request (Origin) and the host name under which it reached this
computer (Host). Pages of other websites have another origin. A website whose name was pointed at this computer (DNS
rebinding) has another host name.
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
    """Return the token from the environment, or a new one."""
    return os.environ.get(TOKEN) or secrets.token_urlsafe(16)


def refusal(path: str, headers: Mapping[str, str], token: str) -> Optional[str]:
    """Return the reason why a request is refused, or None if it is admitted."""
    given = headers.get("Host", "")
    name = re.sub(r":\d*$", "", given).strip("[]").lower()
    try:
        ipaddress.ip_address(name)  # Unlike a name, an address cannot be rebound.
    except ValueError:
        if name != "localhost":
            return f"{name!r} is not a name of this computer: open the page by its address, such as 127.0.0.1"
    if "Origin" in headers and headers["Origin"].partition("://")[2] != given:
        return "a page of another website may not use this page"
    if not hmac.compare_digest(
        re.split("[/?]", path.lstrip("/"))[0].encode(errors="replace"), token.encode()
    ):
        return "the address lacks the token: use the address that the viewer prints"
    return None


@contextlib.contextmanager
def guarded(token: str) -> Iterator[None]:
    """Apply `refusal` to every request of a viser server that is started inside this context."""
    # viser 1.1.1 (requirements/viewer.txt) cannot refuse requests itself, but process_request of websockets.serve can.
    # tests/live/test_viewer.py fails if another version of viser does not use this function.
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

    server.serve = serve_guarded  # type: ignore[assignment, misc]  # A function replaces the class of websockets.
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]  # Class names are constants for mypy.
