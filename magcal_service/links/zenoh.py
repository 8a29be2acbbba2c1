"""``zenoh:ENDPOINT``: messages over zenoh, with recovery of lost samples, late joiners and liveliness.

Threads: zenoh's own call ``_arrived``, ``_transport`` and ``_presence``, which only queue or count; a keeper thread
lives while a session has to be opened; ``receive`` and ``send`` belong to the caller.  ``_lock`` guards the session
and is never taken by a callback, since zenoh may call back from inside a declaration.
"""

from __future__ import annotations

import errno
import logging
import os
import re
import threading
import time
from collections.abc import Sequence
from functools import partial

import zenoh

from magcal_service.base.errors import LinkError, why_not
from magcal_service.config.address import LinkAddress
from magcal_service.links.base import Link, Role
from magcal_service.links.fair_inbox import TURN, FairInbox
from magcal_service.links.joining import Joining, StreamName
from magcal_service.links.presence import Presence, PresenceBoard
from magcal_service.links.publishers import ask, stream_of, stream_of_token
from magcal_service.links.rate_limit import RateLimit
from magcal_service.links.states import BackOff, LinkEvent, LinkLife, LinkState
from magcal_service.links.zenoh_log import DENIALS, watch
from magcal_service.links.zenoh_session import ZenohSession, is_kept
from magcal_service.links.zenoh_settings import ZenohSettings, exposures, has_rules
from magcal_service.wire.codec import MAX_PAYLOAD_BYTES
from magcal_service.wire.keys import ROOT, key_of
from magcal_service.wire.kinds import kind_of
from magcal_service.wire.messages import Command, Message

_log = logging.getLogger("magcal.links.zenoh")

_FIRST_ATTEMPT_S = 1.0  # how long the constructor of a connecting link waits, so that most links are up when it returns

_ASK_S = 1.0  # longest wait for the tokens of the daemons that are there
_ASK_AGAIN_S = 0.05  # between two questions for them, twenty within that wait


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
        self._session: ZenohSession | None = None
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

    def _served_now(self, session: ZenohSession) -> set[str]:
        found = set[str]()
        try:
            for presence in session.present(_ASK_S):
                if presence.role is Role.SERVICE:
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
        kept = is_kept(kind_of(message))
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
        try:
            self._session.put(message, payload)
        except zenoh.ZError as error:
            self._failed(error)
            return False
        return True

    def _name(self) -> str:
        session = self._session
        return self._settings.name or ("" if session is None else session.name)

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
        session = self._session
        if session is not None and not session.knows(key) and message.craft in self.crafts:
            with self._lock:  # zenoh then knows where the next one of this key goes, even without a publisher here
                if self._session is not None:
                    self._session.declare_key(key)
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
            again, over = partial(self._sent_again, name), partial(self._asked, name)
            ask(session.zenoh, token.key_expr, self.history, again, over)

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
            raise LinkError(f"link {self.address!r} cannot listen: {_why_not_listening(error)}") from None

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
        session = ZenohSession(self._config, self._settings, self.role, self.most_sources)
        with self._lock:
            self._session = session
            try:
                self._declare(session)
            except zenoh.ZError:
                self._drop_session()
                raise
            if self._life.happens(LinkEvent.OPENED).to is LinkState.CLOSED:
                self._drop_session()

    def _declare(self, session: ZenohSession) -> None:
        session.follow_transports(self._transport)
        if self.role is Role.SERVICE:
            session.prepare(self.crafts)
        names = [f"{ROOT}/{craft}" for craft in sorted(self.crafts)]
        if not names or self._settings.listen:  # at a listening end, what is addressed to nobody is counted as well
            names = [f"{ROOT}/*"]
        for name in names:
            session.subscribe(name, self._arrived, self._publisher_seen)
            session.follow_presence(name, self._presence)
        for craft in sorted(self.crafts):  # after the subscriptions: an end that is seen alive also receives
            session.announce(craft)

    def _failed(self, error: zenoh.ZError) -> None:
        """After a failed put: a session that has died is opened anew in the background."""
        session = self._session
        if session is None or not session.is_closed or not self._life.happens(LinkEvent.SESSION_ENDED).logged:
            return
        _log.warning("%s: the session died (%s); opening it again", self.address, str(error).partition(" at /")[0])
        self._drop_session()
        self._keep_trying()

    def _drop_session(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            session.close()
        for other in tuple(self._transports):
            self._connection(other, up=False)
        self._board.clear()


def _why_not_listening(error: zenoh.ZError) -> str:
    """What kept zenoh from listening, and what to do; it says where in its own sources, and the system's number."""
    told = str(error).partition(" at /")[0].rstrip(".")
    number = re.search(r"\(os error (\d+)\)", told)
    if number is None:
        return f"{told}; give an address of this machine, with what its protocol needs"
    system = OSError(int(number[1]), os.strerror(int(number[1])))
    to_do = "free it or choose another" if system.errno == errno.EADDRINUSE else "give another address or port"
    return f"{why_not(system)}; {to_do}"
