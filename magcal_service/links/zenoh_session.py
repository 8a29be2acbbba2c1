"""One open session of zenoh and what is declared in it: publishers, keys, tokens, subscriptions; all gone with it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import zenoh
from zenoh import ext, handlers

from magcal_service.config.rules import RESERVED_SOURCE
from magcal_service.links.base import Role
from magcal_service.links.presence import Presence, presence_of
from magcal_service.links.zenoh_settings import ZenohSettings
from magcal_service.wire.keys import ROOT, encoding_of, group_of, key_of
from magcal_service.wire.kinds import KINDS, Kind, kind_of
from magcal_service.wire.messages import Message

_HEARTBEAT_S = 0.5  # an advanced publisher repeats its last number this long after a change, so the last one counts too
_KEPT_RESULTS = ("estimate", "status")  # a late joiner gets the newest of these at once

_RECOVERY = ext.RecoveryConfig(periodic_queries=None, heartbeat=True)


class ZenohSession:
    """One open session, used under its link's lock; callbacks come on zenoh's own threads.

    Parameters
    ----------
    config: the session's configuration.
    settings, role: of the link.
    most: publishers, keys and tokens that are declared at most, each.

    Raises
    ------
    zenoh.ZError: the session cannot be opened; so does each of its methods where the session refuses.
    """

    def __init__(self, config: zenoh.Config, settings: ZenohSettings, role: Role, most: int) -> None:
        self.zenoh = zenoh.open(config)
        self._settings = settings
        self._role = role
        self.most = most
        self._held: list[object] = []  # declarations live as long as they are referred to
        self._publishers: dict[str, ext.AdvancedPublisher] = {}
        self._announced: set[str] = set()
        self._keys: dict[str, zenoh.KeyExpr] = {}

    @property
    def name(self) -> str:
        """What this end is called in its tokens: by its settings, or by the session's identity."""
        return self._settings.name or str(self.zenoh.zid())[:32]

    @property
    def is_closed(self) -> bool:
        """Whether the session has died, or was closed."""
        return self.zenoh.is_closed()

    def close(self) -> None:
        """Let go of every declaration, and close."""
        self._held.clear()
        self._publishers.clear()
        self._announced.clear()
        self._keys.clear()
        if not self.zenoh.is_closed():
            self.zenoh.close()  # type: ignore[no-untyped-call]

    # Sending

    def put(self, message: Message, payload: bytes) -> None:
        """Put one message, by the publisher of its key where its kind is kept; its craft is announced before."""
        kind, key = kind_of(message), key_of(message)
        self.announce(message.craft)
        publisher = self._publisher(key, kind) if is_kept(kind) else None
        # Not express: each such message takes one of 16 places, so that a burst is dropped in silence when zenoh's
        # own threads get no processor for 50 ms.  Without, it shares places, and is as quick where there is room.
        if publisher is None:  # a publisher drops what it is given before it knows of a router's subscribers
            self.zenoh.put(self.declare_key(key), payload, encoding=encoding_of(kind))
        else:
            publisher.put(payload)

    def announce(self, craft: str) -> None:
        """Show this end's token for a craft, once."""
        if craft not in self._announced and len(self._announced) < self.most:
            self._announced.add(craft)
            self._held.append(self.zenoh.liveliness().declare_token(Presence(craft, self._role, self.name).key))

    def knows(self, key: str) -> bool:
        """Whether a key is declared; may be asked without the lock."""
        return key in self._keys

    def declare_key(self, key: str) -> zenoh.KeyExpr | str:
        """A key that zenoh has looked up once: among a thousand craft it would be looked up for each message."""
        if key not in self._keys and len(self._keys) < self.most:
            self._keys[key] = self.zenoh.declare_keyexpr(key)
        return self._keys.get(key, key)

    def prepare(self, crafts: Iterable[str]) -> None:
        """Declare the publishers of all craft now: with a thousand craft each takes a millisecond, which a vector
        would wait for."""
        for craft in sorted(crafts):
            for kind in KINDS:
                if kind.name in _KEPT_RESULTS:
                    self._publisher(f"{ROOT}/{craft}/{group_of(kind)}/{kind.name}/{RESERVED_SOURCE}", kind)

    def _publisher(self, key: str, kind: Kind) -> ext.AdvancedPublisher | None:
        """The publisher of a kind that is kept for recovery and late joiners; None beyond the number of sources."""
        if key not in self._publishers and len(self._publishers) < self.most:
            depth = self._settings.cache if group_of(kind) == "sample" else 1
            self._publishers[key] = ext.declare_advanced_publisher(
                self.zenoh,
                key,
                encoding=encoding_of(kind),
                cache=ext.CacheConfig(depth),
                sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S),
                publisher_detection=True,
            )
        return self._publishers.get(key)

    # Receiving

    def follow_transports(self, changed: Callable[[zenoh.TransportEvent], None]) -> None:
        """Call for each other end that connects or is lost, and for those that are connected already."""
        self._held.append(self.zenoh.info.declare_transport_events_listener(_direct(changed), history=True))

    def follow_presence(self, name: str, changed: Callable[[zenoh.Sample], None]) -> None:
        """Call for each token under a name (``ROOT/CRAFT``) that appears or goes, and for those that are there."""
        self._held.append(self.zenoh.liveliness().declare_subscriber(f"{name}/alive/*", _direct(changed), history=True))

    def present(self, wait_s: float) -> Iterator[Presence]:
        """The other ends that show themselves, asked for now; takes ``wait_s`` [s] at most."""
        for reply in self.zenoh.liveliness().get(f"{ROOT}/*/alive/*", timeout=wait_s):
            presence = None if reply.ok is None else presence_of(str(reply.ok.key_expr))
            if presence is not None:
                yield presence

    def subscribe(
        self, name: str, arrived: Callable[[zenoh.Sample], None], publisher: Callable[[zenoh.Sample], None]
    ) -> None:
        """Subscribe to what this role receives under a name (``ROOT/CRAFT``).

        ``publisher`` is called with the tokens of nodes' publishers, where they are asked for what they keep.
        """
        if self._role is Role.SERVICE:
            # At least the newest: to one that knows no number a publisher's heartbeat would bring all that it keeps.
            depth = max(1, self._settings.history)
            samples = self._recovering(f"{name}/sample/**", arrived, depth)
            self._held += [samples, self.zenoh.declare_subscriber(f"{name}/command", _direct(arrived))]
            if self._settings.history:
                self._held.append(samples.detect_publishers(_direct(publisher), history=True))
            return
        self._held.append(self._recovering(f"{name}/result/**", arrived, 1))
        self._held.append(self.zenoh.declare_subscriber(f"{name}/reply", _direct(arrived)))
        if self._role is Role.VIEWER and self._settings.samples:
            self._held.append(self.zenoh.declare_subscriber(f"{name}/sample/**", _direct(arrived)))

    def _recovering(self, key: str, arrived: Callable[[zenoh.Sample], None], depth: int) -> ext.AdvancedSubscriber[Any]:
        """A subscriber that asks for what it missed, and for the newest ``depth`` of each publisher."""
        history = ext.HistoryConfig(detect_late_publishers=True, max_samples=depth)
        return ext.declare_advanced_subscriber(self.zenoh, key, _direct(arrived), recovery=_RECOVERY, history=history)


def is_kept(kind: Kind) -> bool:
    """Whether messages of a kind are kept by their publisher, for recovery and late joiners."""
    return group_of(kind) == "sample" or kind.name in _KEPT_RESULTS


def _direct(callback: Callable[[Any], None]) -> Any:
    """A callback on zenoh's own thread: a thread between them would keep the process alive at its end."""
    return handlers.Callback(callback, indirect=False)
