"""Allowed names and addresses of a server: a request with another Host or Origin is refused.

A page of another site in a browser on this machine may have a name that resolves to this server (DNS rebinding). The
requests of this page contain its name, which is not in the list.
"""

import socket
from collections.abc import Sequence
from urllib.parse import urlsplit

from tornado.httputil import HTTPServerRequest

LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})


class OwnHosts:
    """Names of this machine, and names allowed by the user.

    Args:
        address: address of the server. The machine's host name is allowed unless ``address`` is a loopback address.
        allowed: further names or addresses.
    """

    def __init__(self, address: str, allowed: Sequence[str] = ()) -> None:
        own = (
            set()
            if address in LOOPBACK
            else {_normalised_host(socket.gethostname()), f"{_normalised_host(socket.gethostname())}.local"}
        )
        self._names = LOOPBACK | own | {_normalised_host(name) for name in allowed}

    def is_own_host(self, request: HTTPServerRequest) -> bool:
        """True if the Host of a request is in the list, or is the address at which the request arrived."""
        name = host_of(f"//{request.host}")
        return name in self._names or name == _local_address(request)

    def is_own_origin(self, origin: str, request: HTTPServerRequest) -> bool:
        """True if the host of an Origin is in the list, on any port, or is the address at which the request arrived."""
        name = host_of(origin)
        return name in self._names or name == _local_address(request)


def host_of(address: str) -> str | None:
    """Return the host in an address, without port, in lower case; None if the address has no host."""
    try:
        name = urlsplit(address).hostname
    except ValueError:
        return None
    return None if name is None else _normalised_host(name)


def _normalised_host(name: str) -> str:
    return name.strip("[]").rstrip(".").lower()


def _local_address(request: HTTPServerRequest) -> str | None:
    """Return the address of this machine at which a request arrived; None if unknown."""
    stream = getattr(request.connection, "stream", None)
    if stream is None or stream.socket is None:
        return None
    address = str(stream.socket.getsockname()[0])
    return address.partition("%")[0].removeprefix("::ffff:").lower()
