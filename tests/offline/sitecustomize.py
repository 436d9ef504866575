"""Python imports this before anything else where its folder is on the path: what leaves
this machine is refused, and written to the file that `ASLO_JAX_TEST_NETWORK` names, since
whoever asked may take a refusal for a network that is down. What is not Python is not seen.
"""

import ipaddress
import os
import sys
from typing import Any

NAMES = ("socket.getaddrinfo", "socket.gethostbyname", "socket.gethostbyaddr")
ADDRESSES = ("socket.connect", "socket.sendto", "socket.sendmsg")


def is_here(host: Any) -> bool:
    """Whether a host is this machine; paths of local sockets and the like are."""
    name = host.decode() if isinstance(host, bytes) else host
    if not isinstance(name, str) or name in ("", "localhost"):
        return True
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        return False
    return address.is_loopback or address.is_unspecified


def refuse(event: str, given: tuple) -> None:
    """An audit hook: https://docs.python.org/3/library/audit_events.html."""
    if event in NAMES:
        host = given[0]
    elif event in ADDRESSES and isinstance(given[1], tuple):
        host = given[1][0]
    else:
        return
    if is_here(host):
        return
    if path := os.environ.get("ASLO_JAX_TEST_NETWORK"):
        with open(path, "a") as attempts:  # noqa: PTH123 - pathlib is not imported yet
            attempts.write(f"{event} {host}\n")
    raise OSError(f"no network: {event} {host}")


sys.addaudithook(refuse)
