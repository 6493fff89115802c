"""Requests of the page: they need a random token in the address and a local host name.

A browser sends the origin of the page that makes a request (Origin) and the host name under which
it reached this computer (Host). Pages of other websites have another origin. A website whose name
was pointed at this computer (DNS rebinding) has another host name.
"""

from __future__ import annotations

import contextlib
import hmac
import ipaddress
import os
import re
import secrets
from http import HTTPStatus
from typing import Any, Callable, Iterator, Mapping, Optional

TOKEN = "APPLR_VIEWER_TOKEN"  # environment variable that sets the token
HTML = "text/html"  # type of viser's page


def token() -> str:
    """Return the token from the environment, or a new one."""
    return os.environ.get(TOKEN) or secrets.token_urlsafe(16)


def refusal(path: str, headers: Mapping[str, str], token: str) -> Optional[str]:
    """Return the reason why a request is refused, or None if it is admitted."""
    host = headers.get("Host", "")
    host_name = re.sub(r":\d*$", "", host).strip("[]").lower()
    try:
        ipaddress.ip_address(host_name)  # Unlike a name, an address cannot be rebound.
    except ValueError:
        if host_name != "localhost":
            advice = "open the page by its address, such as 127.0.0.1"
            return f"{host_name!r} is not a name of this computer: {advice}"

    # Programs other than browsers send no origin. They still need the token.
    if "Origin" in headers and headers["Origin"].partition("://")[2] != host:
        return "a page of another website may not use this page"

    # The time of this comparison does not depend on the number of equal characters.
    first_part = re.split("[/?]", path.lstrip("/"))[0]
    if not hmac.compare_digest(first_part.encode(errors="replace"), token.encode()):
        return "the address lacks the token: use the address that the viewer prints"
    return None


@contextlib.contextmanager
def guarded(token: str, dress: Callable[[bytes], bytes]) -> Iterator[None]:
    """Guard a viser server that is started inside this context.

    Args:
        token: Token of `refusal`, which is applied to every request.
        dress: Returns the page that is served, from viser's.
    """
    # viser 1.1.1 (requirements/viewer.txt) cannot refuse requests itself, but process_request of
    # websockets.serve can. tests/live/test_viewer.py fails if another version of viser does not use
    # this function.
    from websockets.asyncio import server

    serve = server.serve

    def serve_guarded(*arguments: Any, process_request: Any, **options: Any) -> Any:
        def process_admitted(connection: Any, request: Any) -> Any:
            reason = refusal(request.path, request.headers, token)
            if reason:
                return connection.respond(HTTPStatus.FORBIDDEN, reason + "\n")
            # viser serves its files without the token in their addresses.
            request.path = request.path.replace("/" + token, "", 1) or "/"
            # Only a page that is not compressed can be dressed.
            if "Accept-Encoding" in request.headers:
                del request.headers["Accept-Encoding"]
            response = process_request(connection, request)
            # A websocket has no response here, and "not found" has no type.
            if response is not None and response.headers.get("Content-Type") == HTML:
                response.body = dress(response.body)
                del response.headers["Content-Length"]
                response.headers["Content-Length"] = str(len(response.body))
            return response

        return serve(*arguments, process_request=process_admitted, **options)

    # A function replaces the class of websockets.
    server.serve = serve_guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]  # Class names are constants for mypy.
