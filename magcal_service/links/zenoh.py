"""``zenoh:ENDPOINT``: messages over zenoh, with recovery of lost samples, late joiners and liveliness.

Threads: zenoh's own call ``_arrived``, ``_transport`` and ``_presence``, which only queue or count; a keeper thread
lives while a session has to be opened; ``receive`` and ``send`` belong to the caller.  ``_lock`` guards the session
and is never taken by a callback, since zenoh may call back from inside a declaration.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import zenoh
from zenoh import ext, handlers

from magcal_service.config.address import LinkAddress
from magcal_service.config.rules import RESERVED_SOURCE
from magcal_service.errors import LinkError
from magcal_service.links.base import Link, Role
from magcal_service.links.fair_inbox import TURN, FairInbox
from magcal_service.links.joining import Joining, StreamName
from magcal_service.links.presence import Presence, PresenceBoard, presence_of
from magcal_service.links.publishers import ask, stream_of, stream_of_token
from magcal_service.links.rate_limit import RateLimit
from magcal_service.links.states import BackOff, LinkEvent, LinkLife, LinkState
from magcal_service.links.zenoh_log import DENIALS, watch
from magcal_service.links.zenoh_settings import ZenohSettings, exposures, has_rules
from magcal_service.wire.codec import MAX_PAYLOAD_BYTES
from magcal_service.wire.keys import ROOT, encoding_of, group_of, key_of
from magcal_service.wire.kinds import KINDS, Kind, kind_of
from magcal_service.wire.messages import Command, Message

_log = logging.getLogger("magcal.links.zenoh")

_HEARTBEAT_S = 0.5  # an advanced publisher repeats its last number this long after a change, so the last one counts too
_KEPT_RESULTS = ("estimate", "status")  # a late joiner gets the newest of these at once
_FIRST_ATTEMPT_S = 1.0  # how long the constructor of a connecting link waits, so that most links are up when it returns

_ASK_S = 1.0  # longest wait for the tokens of the daemons that are there
_ASK_AGAIN_S = 0.05  # between two questions for them, twenty within that wait

_RECOVERY = ext.RecoveryConfig(periodic_queries=None, heartbeat=True)


class ZenohLink(Link):
    """One end of a zenoh link; options in ``ZenohSettings`` and ``docs/links.md``.

    Counts besides those of every link: ``deferred`` (put while nobody was connected, kept for recovery),
    ``joined`` and ``left`` (liveliness), ``refused.wrong_craft`` and ``refused.wrong_key`` (key and payload disagree),
    and in the daemon ``denied.<name>`` (see ``zenoh_log``).

    Raises
    ------
    LinkAddressError: an option, the endpoint or the configuration file is refused.
    LinkError: a listening link cannot open its endpoint.
    ConfigError: a file with a secret in it can be read by others, or everybody can write the configuration file.
    """

    def __init__(self, address: LinkAddress, role: Role, crafts: Sequence[str] = ()) -> None:
        super().__init__(address.text, crafts)
        self.counters.update(dict.fromkeys(("joined", "left", "refused.too_large", "refused.too_fast"), 0))
        self.role = role
        self._settings = ZenohSettings.read(address, role)
        self._config = self._settings.session_config(address)
        self._settings.check_files(self._config)
        self.warnings, self.history = exposures(self._config), self._settings.history
        if role is Role.SERVICE:
            self.counters.update(dict.fromkeys((f"denied.{name}" for name in DENIALS), 0))
            watch(self._count, address.text, has_rules(self._config))
        self._inbox: FairInbox[zenoh.Sample | StreamName] = FairInbox(
            self._settings.queue, self._overflowed, crafts, TURN if role is Role.SERVICE else None
        )
        self._rate = RateLimit(self._settings.rate, float(self._settings.queue))
        self._board = PresenceBoard(self._count)
        self._joining: Joining[zenoh.Sample] = Joining(TURN, self._taken, self.most_sources)
        self._lock = threading.RLock()
        self._life = LinkLife()  # ``up`` and ``down`` count the other ends, see ``_connection``
        self._closed = threading.Event()  # wakes the keeper out of its pause
        self._session: zenoh.Session | None = None
        self._held: list[object] = []  # declarations live as long as they are referred to
        self._publishers: dict[str, ext.AdvancedPublisher] = {}
        self._announced: set[str] = set()
        self._keys: dict[str, zenoh.KeyExpr] = {}
        self._transports: set[str] = set()
        self._transports_lock = threading.Lock()
        if self._settings.listen:
            self._listen()
        else:
            self._keep_trying().wait(_FIRST_ATTEMPT_S)

    def alive(self) -> frozenset[Presence]:
        """The other ends that are present, by craft, role and name; each receives what is sent from now on."""
        own = (self.role, self._name())
        return frozenset(presence for presence in self._board.present() if (presence.role, presence.name) != own)

    @property
    def connected(self) -> bool:
        """Whether at least one other end is connected now."""
        return bool(self._transports)

    @property
    def alone(self) -> str:
        """Why nobody can be at the other end now: who listens may be found by others at any time."""
        if self.connected or self._settings.listen:
            return ""
        return f"nobody is at {self._settings.endpoint}, or it refuses this end (certificate, password)"

    def served(self) -> frozenset[str]:
        """The craft of the daemons that show themselves, asked for now."""
        session, deadline_s = self._session, time.monotonic() + _ASK_S
        found = {presence.craft for presence in self.alive() if presence.role is Role.SERVICE}
        if session is None or not self.connected:
            return frozenset()
        while True:  # zenoh's answer is empty at once every few times, whoever is there
            found |= self._served_now(session)
            if found or time.monotonic() > deadline_s or not self.connected:
                return frozenset(found)
            self._closed.wait(_ASK_AGAIN_S)

    def _served_now(self, session: zenoh.Session) -> set[str]:
        found = set[str]()
        try:
            for reply in session.liveliness().get(f"{ROOT}/*/alive/*", timeout=_ASK_S):
                presence = None if reply.ok is None else presence_of(str(reply.ok.key_expr))
                if presence is not None and presence.role is Role.SERVICE:
                    found.add(presence.craft)
        except zenoh.ZError as error:
            self._failed(error)
        return found

    def _poll(self, wait_s: float) -> list[Message]:
        arrived = self._inbox.drain(self._joining.wait_s(time.monotonic(), wait_s))
        now_s = time.monotonic()
        passed = [message for one in arrived if (message := self._passed(one, now_s)) is not None]
        return [*passed, *self._joining.due(now_s)]  # what was held until now must not overtake its references

    def _passed(self, sample: zenoh.Sample | StreamName, now_s: float) -> Message | None:
        """The message of what has arrived, where it needs not wait for what its publisher sends again."""
        if isinstance(sample, StreamName):
            self._joining.complete(sample, now_s)
            return None
        message = self._taken(sample)
        recovers = self.role is Role.SERVICE and self.history
        if message is None or isinstance(message, Command) or not recovers or message.craft not in self.crafts:
            return message
        found = stream_of(sample)
        return message if found is None or not self._joining.keeps(*found, message, now_s) else None

    def send(self, message: Message) -> None:
        """Put one message; never waits for the other end and never raises.

        While a connecting link is down, samples, estimates and statuses stay in the publisher's cache and are counted
        as ``deferred``; everything else, and everything before the first connection, is counted as ``dropped``.
        """
        payload = self._encoded(message)
        if payload is None:
            self._count("dropped")
            return
        with self._lock:
            put = self._put(message, payload)
        kept = _cached(kind_of(message))
        if not put or not (self.connected or self._settings.listen or kept):
            self._count("dropped")
            return
        self._count("sent")
        if not self.connected and not self._settings.listen:
            self._count("deferred")

    def close(self) -> None:
        """Close the session; an attempt to connect that is under way ends by itself within seconds."""
        self._life.happens(LinkEvent.CLOSE)
        self._closed.set()
        with self._lock:
            self._drop_session()

    # Sending

    def _put(self, message: Message, payload: bytes) -> bool:
        if self._session is None:
            return False
        kind, key = kind_of(message), key_of(message)
        try:
            self._announce(self._session, message.craft)
            publisher = self._publisher(self._session, key, kind) if _cached(kind) else None
            # Not express: each such message takes one of 16 places, so that a burst is dropped in silence when zenoh's
            # own threads get no processor for 50 ms.  Without, it shares places, and is as quick where there is room.
            if publisher is None:  # a publisher drops what it is given before it knows of a router's subscribers
                self._session.put(self._declared(self._session, key), payload, encoding=encoding_of(kind))
            else:
                publisher.put(payload)
        except zenoh.ZError as error:
            self._failed(error)
            return False
        return True

    def _publisher(self, session: zenoh.Session, key: str, kind: Kind) -> ext.AdvancedPublisher | None:
        """The publisher of a kind that is kept for recovery and late joiners; None beyond the number of sources."""
        if key not in self._publishers and len(self._publishers) < self.most_sources:
            depth = self._settings.cache if group_of(kind) == "sample" else 1
            self._publishers[key] = ext.declare_advanced_publisher(
                session,
                key,
                encoding=encoding_of(kind),
                cache=ext.CacheConfig(depth),
                sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S),
                publisher_detection=True,
            )
        return self._publishers.get(key)

    def _declared(self, session: zenoh.Session, key: str) -> zenoh.KeyExpr | str:
        """A key that zenoh has looked up once: among a thousand craft it would be looked up for each message."""
        if key not in self._keys and len(self._keys) < self.most_sources:
            self._keys[key] = session.declare_keyexpr(key)
        return self._keys.get(key, key)

    def _announce(self, session: zenoh.Session, craft: str) -> None:
        if craft not in self._announced and len(self._announced) < self.most_sources:
            self._announced.add(craft)
            self._held.append(session.liveliness().declare_token(Presence(craft, self.role, self._name()).key))

    def _name(self) -> str:
        session = self._session
        return self._settings.name or ("" if session is None else str(session.zid())[:32])

    # Receiving

    def _taken(self, sample: zenoh.Sample) -> Message | None:
        if sample.kind != zenoh.SampleKind.PUT:
            return None
        message = self._decoded(sample.payload.to_bytes())
        if message is None:
            return None
        key = str(sample.key_expr)
        if key != key_of(message):
            same_craft = key.startswith(f"{ROOT}/{message.craft}/")
            self._count("refused.wrong_key" if same_craft else "refused.wrong_craft")
            return None
        if key not in self._keys and message.craft in self.crafts:
            with (
                self._lock
            ):  # zenoh then knows where the next one of this key goes, even from a node without a publisher
                if self._session is not None:
                    self._declared(self._session, key)
        return message

    def _arrived(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        craft, _, source = key.removeprefix(f"{ROOT}/").partition("/")
        if len(sample.payload) > MAX_PAYLOAD_BYTES:
            self._count("refused.too_large")
        elif not self._rate.allows(key, time.monotonic()):
            self._count("refused.too_fast")
        else:
            self._inbox.put(sample, craft, source)

    def _overflowed(self, craft: str) -> None:
        self._count("overflow")
        if craft:
            self.overflows[craft] += 1

    def _transport(self, event: zenoh.TransportEvent) -> None:
        self._connection(str(event.transport.zid), event.kind == zenoh.SampleKind.PUT)

    def _connection(self, other: str, up: bool) -> None:
        with self._transports_lock:
            if up != (other in self._transports):
                (self._transports.add if up else self._transports.discard)(other)
                self._count("up" if up else "down")

    def _presence(self, sample: zenoh.Sample) -> None:
        self._board.change(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

    def _publisher_seen(self, token: zenoh.Sample) -> None:
        """A node's publisher appears or is gone: it is asked for its newest messages."""
        name, session = stream_of_token(token), self._session
        if name is None or session is None or name.craft not in self.crafts:
            return
        if token.kind != zenoh.SampleKind.PUT:
            self._joining.gone(name)
        elif self._joining.shown(name, time.monotonic()):
            ask(session, token.key_expr, self.history, partial(self._sent_again, name), partial(self._asked, name))

    def _sent_again(self, name: StreamName, sample: zenoh.Sample) -> None:
        found = stream_of(sample)
        if found is not None and found[0] == name and len(sample.payload) <= MAX_PAYLOAD_BYTES:
            self._joining.again(*found, sample)

    def _asked(self, name: StreamName) -> None:
        """A publisher has sent again what it was asked for: its hold ends after what arrived before, in the inbox."""
        self._inbox.put(name, name.craft, f"{name.session} {name.entity}")

    # The session

    def _listen(self) -> None:
        try:
            self._open()
        except zenoh.ZError as error:
            reason = str(error).partition(" at /")[0]
            raise LinkError(f"link {self.address!r} cannot listen: {reason}; free the port or choose another") from None

    def _keep_trying(self) -> threading.Event:
        """Have a keeper open the session; the event is set once its first attempt is over."""
        tried = threading.Event()
        # Not a daemon thread: one that sits inside zenoh while the interpreter ends would abort the process.
        threading.Thread(target=self._keep, args=(tried,), name="magcal-zenoh-keeper").start()
        return tried

    def _keep(self, tried: threading.Event) -> None:
        back_off = BackOff()
        while not self._life.is_closed and threading.main_thread().is_alive():
            try:
                self._open()
                return
            except zenoh.ZError as error:
                if self._life.happens(LinkEvent.FAILED).logged:
                    _log.info("%s: not connected yet (%s)", self.address, str(error).partition(" at /")[0])
            finally:
                tried.set()
            self._closed.wait(back_off.next_s())

    def _open(self) -> None:
        session = zenoh.open(self._config)
        with self._lock:
            self._session = session
            try:
                self._declare(session)
            except zenoh.ZError:
                self._drop_session()
                raise
            if self._life.happens(LinkEvent.OPENED).to is LinkState.CLOSED:
                self._drop_session()

    def _declare(self, session: zenoh.Session) -> None:
        self._held.append(session.info.declare_transport_events_listener(_direct(self._transport), history=True))
        if self.role is Role.SERVICE:
            self._prepare(session)
        names = [f"{ROOT}/{craft}" for craft in sorted(self.crafts)]
        if not names or self._settings.listen:  # at a listening end, what is addressed to nobody is counted as well
            names = [f"{ROOT}/*"]
        for name in names:
            self._held.extend(self._subscriptions(session, name))
            presence = session.liveliness().declare_subscriber(f"{name}/alive/*", _direct(self._presence), history=True)
            self._held.append(presence)
        for craft in sorted(self.crafts):  # after the subscriptions: an end that is seen alive also receives
            self._announce(session, craft)

    def _prepare(self, session: zenoh.Session) -> None:
        """Declare the publishers of all craft now: with a thousand craft each takes a millisecond, which a vector
        would wait for."""
        for craft in sorted(self.crafts):
            for kind in KINDS:
                if kind.name in _KEPT_RESULTS:
                    self._publisher(session, f"{ROOT}/{craft}/{group_of(kind)}/{kind.name}/{RESERVED_SOURCE}", kind)

    def _subscriptions(self, session: zenoh.Session, name: str) -> list[object]:
        arrived = _direct(self._arrived)
        if self.role is Role.SERVICE:
            # At least the newest: to one that knows no number a publisher's heartbeat would bring all that it keeps.
            history = _history(max(1, self._settings.history))
            samples = ext.declare_advanced_subscriber(
                session, f"{name}/sample/**", arrived, recovery=_RECOVERY, history=history
            )
            held: list[object] = [samples, session.declare_subscriber(f"{name}/command", arrived)]
            if self._settings.history:
                held.append(samples.detect_publishers(_direct(self._publisher_seen), history=True))
            return held
        results = ext.declare_advanced_subscriber(
            session, f"{name}/result/**", arrived, recovery=_RECOVERY, history=_history(1)
        )
        held = [results, session.declare_subscriber(f"{name}/reply", arrived)]
        if self.role is Role.VIEWER and self._settings.samples:
            held.append(session.declare_subscriber(f"{name}/sample/**", arrived))
        return held

    def _failed(self, error: zenoh.ZError) -> None:
        """After a failed put: a session that has died is opened anew in the background."""
        session = self._session
        if session is None or not session.is_closed() or not self._life.happens(LinkEvent.SESSION_ENDED).logged:
            return
        _log.warning("%s: the session died (%s); opening it again", self.address, str(error).partition(" at /")[0])
        self._drop_session()
        self._keep_trying()

    def _drop_session(self) -> None:
        session, self._session = self._session, None
        self._held.clear()
        self._publishers.clear()
        self._announced.clear()
        self._keys.clear()
        if session is not None and not session.is_closed():
            session.close()  # type: ignore[no-untyped-call]
        for other in tuple(self._transports):
            self._connection(other, up=False)
        self._board.clear()


def _cached(kind: Kind) -> bool:
    return group_of(kind) == "sample" or kind.name in _KEPT_RESULTS


def _history(depth: int) -> ext.HistoryConfig:
    return ext.HistoryConfig(detect_late_publishers=True, max_samples=depth)


def _direct(callback: Callable[[Any], None]) -> Any:
    """A callback on zenoh's own thread: a thread between them would keep the process alive at its end."""
    return handlers.Callback(callback, indirect=False)
