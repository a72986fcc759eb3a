"""Names and addresses under which a server is asked: a request with another Host or Origin is refused.

A page of another site may be open in a browser of this machine, and its name may be made to lead here (DNS rebinding).
Its requests bear its own name, which is not in the list.
"""

import socket
from collections.abc import Sequence
from urllib.parse import urlsplit

from tornado.httputil import HTTPServerRequest

LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})


class OwnHosts:
    """The names of this machine, and those that the user allows.

    Args:
        address: that the server listens on. On a loopback address the machine's own name is no name of the server.
        allowed: further names or addresses.
    """

    def __init__(self, address: str, allowed: Sequence[str] = ()) -> None:
        own = set() if address in LOOPBACK else {_plain(socket.gethostname()), f"{_plain(socket.gethostname())}.local"}
        self._names = LOOPBACK | own | {_plain(name) for name in allowed}

    def is_asked(self, request: HTTPServerRequest) -> bool:
        """True if the Host of a request is in the list, or is the address at which the request came in."""
        name = host_of(f"//{request.host}")
        return name in self._names or name == _local_address(request)

    def is_origin(self, origin: str, request: HTTPServerRequest) -> bool:
        """True if an Origin is a page of a host in the list, on any port."""
        name = host_of(origin)
        return name in self._names or name == _local_address(request)


def host_of(address: str) -> str | None:
    """Return the host in an address, without its port, in small letters; None where there is none."""
    try:
        name = urlsplit(address).hostname
    except ValueError:
        return None
    return None if name is None else _plain(name)


def _plain(name: str) -> str:
    return name.strip("[]").rstrip(".").lower()


def _local_address(request: HTTPServerRequest) -> str | None:
    """Return the address of this machine at which a request came in."""
    stream = getattr(request.connection, "stream", None)
    if stream is None or stream.socket is None:
        return None
    address = str(stream.socket.getsockname()[0])
    return address.partition("%")[0].removeprefix("::ffff:").lower()
