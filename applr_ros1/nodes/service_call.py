"""Calls a ROS service within a deadline. The reconfigure client calls this.

rospy's ServiceProxy has no time-out: a stopped server (SIGSTOP) still accepts the connection and the call never
returns. Here the TCPROS exchange (connection header, request, response) runs on a socket whose every wait ends at
the deadline, so no thread is left behind. The request is sent only after the server has answered the header: one
that was frozen meanwhile never finds an outdated request in its queue when it wakes. Until then the connection is
kept for the next attempt: a server that is frozen for long must not find its short queue (5 in rospy) full of them.
"""

import select
import socket
import struct
import time
import xmlrpc.client
from io import BytesIO
from urllib.parse import urlparse

from applr_ros1.common.errors import ApplrError

MAX_BYTES = 2**22  # of one answer; a set of parameters has a few kB
KEEP = 30.0  # s that a connection waits for a frozen server


class ServiceError(ApplrError):
    """A call that failed; one line.

    answered: the server said no. uncertain: the request was sent and nothing came back, so the server may still carry
    it out.
    """

    def __init__(self, text, answered=False, uncertain=False):
        super().__init__(text)
        self.answered, self.uncertain = answered, uncertain


class Deadline:
    """A moment of the monotonic wall clock. The clock of ROS may stand still, so it cannot bound a wait."""

    def __init__(self, seconds):
        self.at = time.monotonic() + seconds

    def left(self):
        """Seconds left; raises socket.timeout when there are none."""
        left = self.at - time.monotonic()
        if left <= 0.0:
            raise socket.timeout("deadline passed")
        return left


class Master:
    """The ROS master's XML-RPC interface with a deadline on every call."""

    def __init__(self, uri, caller_id):
        self.uri, self.caller_id = uri, caller_id

    def call(self, method, *args, **options):
        """Calls e.g. lookupService; deadline: a Deadline. Returns its value; raises ServiceError."""
        transport = _Transport(options["deadline"])
        try:
            proxy = xmlrpc.client.ServerProxy(self.uri, transport=transport)
            code, text, value = getattr(proxy, method)(self.caller_id, *args)
        except (OSError, xmlrpc.client.Error, ValueError) as e:
            raise ServiceError(f"ROS master {self.uri} does not answer ({_short(e)})") from None
        finally:
            transport.close()
        if code != 1:
            raise ServiceError(text)
        return value


class _Transport(xmlrpc.client.Transport):
    def __init__(self, deadline):
        super().__init__()
        self._deadline = deadline

    def make_connection(self, host):
        connection = super().make_connection(host)
        connection.timeout = self._deadline.left()
        return connection


class ServiceCaller:
    """One service by name. Not for several threads at once."""

    def __init__(self, name, service_class, master):
        self.name, self.service_class, self.master = name, service_class, master
        self._address = None  # of the last success; a restarted server has another one
        self._waiting = None  # (address, socket, time) of a connection whose header was not answered yet

    def call(self, request, deadline):
        """Send a request and return the response, both messages of the service's class.

        Raises:
            ServiceError: Refused, not reached, or not answered before `deadline`.
        """
        if self._address is not None and self._waiting is None:
            try:
                return self._call_at(self._address, request, deadline)
            except ServiceError as e:
                self._address = None  # it may have moved
                if e.answered or e.uncertain or self._waiting is not None:
                    raise
        parsed = urlparse(self.master.call("lookupService", self.name, deadline=deadline))
        address = (parsed.hostname, parsed.port)
        response = self._call_at(address, request, deadline)
        self._address = address
        return response

    def _call_at(self, address, request, deadline):
        sent = False
        try:
            with self._connect(address, deadline) as s:
                self._check(_receive_block(s, deadline))
                body = BytesIO()
                request.serialize(body)
                sent = True
                s.sendall(struct.pack("<I", body.tell()) + body.getvalue())
                ok = _receive(s, 1, deadline)
                answer = _receive_block(s, deadline)
        except socket.timeout:
            raise ServiceError(f"{self.name} does not answer", uncertain=sent) from None
        except OSError as e:
            raise ServiceError(f"{self.name}: connection failed ({_short(e)})", uncertain=sent) from None
        if ok != b"\x01":
            text = answer.decode("utf-8", "replace").strip() or "without a reason"
            raise ServiceError(f"{self.name} refused: {text.splitlines()[0]}", answered=True)
        response = self.service_class._response_class()
        try:
            response.deserialize(answer)
        except Exception as e:  # genpy raises several kinds
            raise ServiceError(
                f"{self.name}: its answer is no {self.service_class._type} ({_short(e)})", answered=True
            ) from None
        return response

    def _connect(self, address, deadline):
        """A socket with an answer to our connection header on it. Raises socket.timeout, and then keeps it."""
        waiting, self._waiting = self._waiting, None
        if waiting is not None and waiting[0] == address and time.monotonic() - waiting[2] < KEEP:
            s, since = waiting[1:]
        else:
            if waiting is not None:
                waiting[1].close()
            since = time.monotonic()
            s = socket.create_connection(address, timeout=deadline.left())
            s.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            s.sendall(self._header())
        if not select.select([s], [], [], max(0.0, deadline.at - time.monotonic()))[0]:
            self._waiting = address, s, since
            raise socket.timeout("no answer to the header")
        return s

    def _header(self):
        fields = {
            "callerid": self.master.caller_id,
            "service": self.name,
            "md5sum": self.service_class._md5sum,
            "type": self.service_class._type,
        }
        packed = b"".join(struct.pack("<I", len(f)) + f for f in (f"{k}={v}".encode() for k, v in fields.items()))
        return struct.pack("<I", len(packed)) + packed

    def _check(self, block):
        """Raises ServiceError when the server's connection header says no."""
        fields, at = {}, 0
        while at + 4 <= len(block):
            (length,) = struct.unpack_from("<I", block, at)
            key, _, value = block[at + 4 : at + 4 + length].partition(b"=")
            fields[key.decode("utf-8", "replace")] = value.decode("utf-8", "replace")
            at += 4 + length
        if "error" in fields:
            raise ServiceError(f"{self.name} refused the connection: {fields['error']}")


def _receive_block(s, deadline):
    (length,) = struct.unpack("<I", _receive(s, 4, deadline))
    if length > MAX_BYTES:
        raise ServiceError(f"answer of {length} bytes is too long")
    return _receive(s, length, deadline)


def _receive(s, count, deadline):
    data = b""
    while len(data) < count:
        s.settimeout(deadline.left())
        part = s.recv(count - len(data))
        if not part:
            raise OSError("closed by the server")
        data += part
    return data


def _short(e):
    return (str(e) or type(e).__name__).splitlines()[0]
