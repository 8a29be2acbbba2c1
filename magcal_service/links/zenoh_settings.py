"""What a ``zenoh:`` address asks for, and the session configuration that follows from it."""

from __future__ import annotations

import ipaddress
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from magcal_service.base.typed_toml import nearest
from magcal_service.config.address import LinkAddress
from magcal_service.config.private_files import check_secret, check_unaltered
from magcal_service.links.base import Role
from magcal_service.wire.codec import MAX_PAYLOAD_BYTES
from magcal_service.wire.fields import NAME

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
_IP_PROTOCOLS = ("quic", "tcp", "tls", "udp", "ws")
_PROTOCOLS = (*_IP_PROTOCOLS, "serial", "unixpipe", "unixsock-stream", "vsock")
_ENCRYPTED = ("quic", "tls")
_SECRET_FILES = (
    "transport/link/tls/listen_private_key",
    "transport/link/tls/connect_private_key",
    "transport/auth/usrpwd/dictionary_file",
    "transport/auth/pubkey/private_key_file",
)
_SECRETS = ("transport/auth/usrpwd/password", "transport/auth/pubkey/private_key_pem")

# Set unless the configuration file says otherwise: no scouting, only the named endpoint is used; reconnection is
# quick (0.4 s after a restart, where zenoh's own takes 3-4 s); and there are time stamps, without which advanced
# publishers cannot recover what was lost.
_DEFAULTS: dict[str, object] = {
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "timestamping/enabled": True,
    "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
    "transport/unicast/open_timeout": 3000,  # how long a mute host can hold one attempt to connect [ms]
    # How long a burst may wait for room, once, until the other end keeps up again [us].  zenoh's own 1 ms drops a
    # third of a burst of 200 in silence on a busy machine.
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 50_000,
    "transport/link/tx/queue/size/data": 16,
    # A connection that takes nothing for this long is closed [us].  With zenoh's own 5 s, giving up one viewer that
    # hangs leaves every other end without messages for 4 s.
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,
    "transport/link/rx/max_message_size": 4 * MAX_PAYLOAD_BYTES,  # bounds what a peer can make this side hold
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenohSettings:
    """A ``zenoh:`` address, read and checked.

    Parameters
    ----------
    endpoint: zenoh endpoint, such as ``"tcp/127.0.0.1:7447"``.
    mode: ``"peer"``, ``"client"`` or ``"router"``.
    listen: listen on the endpoint, or connect to it.
    file: zenoh configuration file (JSON5) that this is laid over, such as certificates and access rules; or None.
    name: this end's name in liveliness tokens; taken from the session where empty.
    cache: samples of each kind and source that a node keeps for recovery.
    history: samples of each kind and source that a service asks for where it joins a running node.
    queue: messages held at most between arrival and ``receive``.
    rate: messages a second that each source may send of each kind, after a burst of ``queue``; 0: no limit [1/s].
    lease_ms: silence after which the other end takes this one for gone [ms].
    samples: whether a viewer receives samples too.
    """

    endpoint: str
    mode: str
    listen: bool
    file: Path | None
    name: str
    cache: int
    history: int
    queue: int
    rate: float
    lease_ms: int
    samples: bool

    @classmethod
    def read(cls, address: LinkAddress, role: Role) -> ZenohSettings:
        """Read the address; ``LinkAddressError`` where a part of it is refused."""
        service = role is Role.SERVICE
        mode = address.choice("mode", ("peer", "client", "router"), "peer" if service else "client")
        listen = address.flag("listen", service and mode != "client")
        if listen and mode == "client":
            address.refuse("listen", "yes", "a client cannot listen; mode=peer or mode=router is accepted with it")
        file = address.text_of("config", "")
        settings = cls(
            endpoint=_endpoint(address),
            mode=mode,
            listen=listen,
            file=Path(file) if file else None,
            name=address.text_of("name", "", NAME.pattern, "a name of 1-32 characters of A-Z a-z 0-9 _ -"),
            cache=address.integer("cache", 1000, 1, 1_000_000),
            history=address.integer("history", 100, 0, 1_000_000),
            queue=address.integer("queue", 4096, 1, 1_000_000),
            rate=address.real("rate", 0.0, 0.0, 1e6),
            lease_ms=address.integer("lease_ms", 4000, 100, 600_000),
            samples=address.flag("samples", True),
        )
        address.finish()
        return settings

    def session_config(self, address: LinkAddress) -> zenoh.Config:
        """The configuration of the session; ``LinkAddressError`` where zenoh refuses the file or the endpoint."""
        try:
            config = zenoh.Config() if self.file is None else zenoh.Config.from_file(self.file)
        except zenoh.ZError as error:
            address.refuse("config", str(self.file), f"a readable zenoh configuration is accepted ({_short(error)})")
        untouched = zenoh.Config()
        defaults = _DEFAULTS | {"listen/endpoints": [], "transport/link/tx/lease": self.lease_ms}
        for key, value in defaults.items():
            if config.get_json(key) == untouched.get_json(key):
                config.insert_json5(key, json.dumps(value))
        config.insert_json5("mode", json.dumps(self.mode))
        try:
            config.insert_json5("listen/endpoints" if self.listen else "connect/endpoints", json.dumps([self.endpoint]))
        except zenoh.ZError as error:
            address.refuse("endpoint", self.endpoint, f"a zenoh endpoint is accepted ({_short(error)})")
        return config

    def check_files(self, config: zenoh.Config) -> None:
        """``ConfigError`` where others can read a file with a secret in it, or everybody write the access rules."""
        for path in filter(None, (_value(config, key) for key in _SECRET_FILES)):
            check_secret(Path(path))
        if self.file is not None:
            check_unaltered(self.file)
            if any(_value(config, key) for key in _SECRETS) or b"_base64" in self.file.read_bytes():
                check_secret(self.file)


def exposures(config: zenoh.Config) -> tuple[str, ...]:
    """What a session with this configuration leaves open to other machines, a line each; none on loopback alone."""
    listening, connecting = _endpoints(config, "listen"), _endpoints(config, "connect")
    warnings = [f"listens on {endpoint} without TLS" for endpoint in listening if not _encrypted(endpoint)]
    warnings += [f"connects to {endpoint} without TLS" for endpoint in connecting if not _encrypted(endpoint)]
    known = _value(config, "transport/link/tls/enable_mtls") or _value(config, "transport/auth/usrpwd/dictionary_file")
    if listening and not known:
        warnings.append("asks nobody who they are: neither client certificates nor passwords")
    if listening and not _value(config, "access_control/enabled"):
        warnings.append("has no access rules: whoever connects may feed, command and look")
    return tuple(warnings)


def has_rules(config: zenoh.Config) -> bool:
    """Whether access rules decide who may do what."""
    return bool(_value(config, "access_control/enabled"))


def _value(config: zenoh.Config, key: str) -> Any:
    return json.loads(config.get_json(key))


def _endpoints(config: zenoh.Config, side: str) -> list[str]:
    """The endpoints of one side that other machines can reach, or that are on them."""
    found = _value(config, f"{side}/endpoints")
    if isinstance(found, dict):
        found = [endpoint for endpoints in found.values() for endpoint in endpoints]
    return [endpoint for endpoint in found or () if _reaches_out(endpoint)]


def _reaches_out(endpoint: str) -> bool:
    protocol, _, place = endpoint.partition("/")
    host = place.partition("#")[0].partition("?")[0].rpartition(":")[0].strip("[]")
    if protocol not in _IP_PROTOCOLS or host == "localhost":
        return False
    try:
        return not ipaddress.ip_address(host.partition("%")[0]).is_loopback
    except ValueError:  # a host name may resolve to another machine later
        return True


def _encrypted(endpoint: str) -> bool:
    return endpoint.partition("/")[0] in _ENCRYPTED


def _endpoint(address: LinkAddress) -> str:
    endpoint = address.rest or DEFAULT_ENDPOINT
    protocol, slash, place = endpoint.partition("/")
    if not slash or not place:
        address.refuse("endpoint", endpoint, f"protocol/place such as {DEFAULT_ENDPOINT!r} is accepted")
    if protocol not in _PROTOCOLS:
        address.refuse("protocol", protocol, nearest(protocol, _PROTOCOLS))
    port = re.search(r":([0-9]{1,5})$", place.partition("#")[0])
    if protocol in _IP_PROTOCOLS and (port is None or int(port[1]) > 65535):
        address.refuse("endpoint", endpoint, f"host and port, such as {DEFAULT_ENDPOINT!r}, are accepted")
    return endpoint


def _short(error: Exception) -> str:
    """zenoh's message without the place in its source."""
    return str(error).partition(" at /")[0]
