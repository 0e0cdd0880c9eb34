"""The ROS master: where it is, whether it answers, and which address we listen on."""

from __future__ import annotations

import os
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException
from typing import Any
from urllib.parse import urlparse
from xmlrpc.client import Error as XmlRpcError
from xmlrpc.client import ServerProxy, Transport

from trocar.errors import InputError, TrocarError

DEFAULT_URI = "http://localhost:11311"
"""Address of the master without ROS_MASTER_URI. Source: rosgraph.rosenv, DEFAULT_MASTER_URI."""

PATIENCE_S = 5.0
"""Time-out of a call to the master [s]. Source: our own choice; it takes milliseconds."""

LOOPBACK = ("localhost", "127.", "::1")


class MasterError(TrocarError):
    """No master answers; `uri` is where one was looked for."""

    def __init__(self, uri: str, given: bool, reason: str) -> None:
        self.uri = uri
        told = "ROS_MASTER_URI" if given else "ROS_MASTER_URI is not set; the usual place"
        super().__init__(
            f"--ros1: no ROS master answers at {uri} ({told}): {reason}. Start one with"
            " `rosmaster --core` or `roscore`, or set ROS_MASTER_URI to where it runs"
        )


@dataclass(frozen=True)
class RosMasterClient:
    """A master that answers within `PATIENCE_S`.

    Attributes:
        uri: where it is
        given: whether ROS_MASTER_URI is set
    """

    uri: str
    given: bool

    def ask(self, verb: str, *arguments: Any) -> tuple[int, str, Any]:
        """Call the master's interface; return (code, message, value).

        Raises:
            MasterError: it does not answer
        """
        try:
            with ServerProxy(self.uri, transport=_Impatient(), allow_none=True) as proxy:
                answer: Any = getattr(proxy, verb)("/trocar", *arguments)
            code, message, value = answer
        except (OSError, HTTPException, XmlRpcError, ValueError, TypeError) as error:
            reason = str(error) or type(error).__name__
            raise MasterError(self.uri, self.given, reason) from error
        return int(code), str(message), value


def find_master() -> RosMasterClient:
    """Return the master that the environment names.

    Raises:
        InputError: ROS_MASTER_URI is no address
        MasterError: no answer
    """
    uri = os.environ.get("ROS_MASTER_URI", "")
    parts = urlparse(uri or DEFAULT_URI)
    try:
        usable = parts.scheme == "http" and parts.hostname and parts.port
    except ValueError:
        usable = False
    if not usable:
        raise InputError(f"ROS_MASTER_URI: got {uri!r}; allowed: http://HOST:PORT ({DEFAULT_URI})")
    master = RosMasterClient(uri or DEFAULT_URI, bool(uri))
    master.ask("getPid")
    return master


def settle_address(master: RosMasterClient) -> str:
    """Choose the address on which the node listens; return a sentence on it, without its subject.

    ROS_HOSTNAME and ROS_IP count where they are set. Else a master on this machine is taken to
    mean that everybody is on this machine.
    """
    host = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP") or ""
    if not host and is_loopback(urlparse(master.uri).hostname or ""):
        os.environ["ROS_HOSTNAME"] = "127.0.0.1"
        return (
            "listens on 127.0.0.1 only; for other machines set ROS_IP to this"
            " machine's address (ROS 1 has no authentication)"
        )
    if is_loopback(host):
        return f"listens on {host} only, set by ROS_HOSTNAME or ROS_IP"
    named = f"advertised as {host}" if host else "advertised as this machine's name"
    return (
        f"listens on all interfaces ({named}); other machines can move the arms:"
        " ROS 1 has no authentication. Set ROS_HOSTNAME=127.0.0.1 to stay local"
    )


def is_loopback(host: str) -> bool:
    """Return whether a name or address means this machine."""
    return host.startswith(LOOPBACK)


class _Impatient(Transport):
    """XML-RPC over HTTP with a limit on every wait."""

    def make_connection(self, host: Any) -> HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = PATIENCE_S
        return connection
