"""The publishers of zenoh's nodes: which one a sample is of, and how it is asked for its newest samples again.

zenoh's own request for them is not enough: where a live sample arrives first, it drops all that are older.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable

import zenoh
from zenoh import handlers

from magcal_service.links.joining import StreamName
from magcal_service.wire.keys import ROOT

_KEY = re.compile(rf"{ROOT}/([^/]+)/sample/([^/]+)/([^/]+)")
_TOKEN = re.compile(rf"{_KEY.pattern}/@adv/pub/([^/]+)/([^/]+)/.*")


def stream_of(sample: zenoh.Sample) -> tuple[StreamName, int] | None:
    """The publisher of a sample and its number there; None where it was put without a publisher that counts."""
    info, key = sample.source_info, _KEY.fullmatch(str(sample.key_expr))
    if info is None or key is None:
        return None
    return StreamName(key[1], key[2], key[3], str(info.source_id.zid), str(info.source_id.eid)), info.source_sn


def stream_of_token(token: zenoh.Sample) -> StreamName | None:
    """The publisher that a token shows; None for one that is not of samples."""
    match = _TOKEN.fullmatch(str(token.key_expr))
    return None if match is None else StreamName(match[1], match[2], match[3], match[4], match[5])


def ask(
    session: zenoh.Session,
    token_key: zenoh.KeyExpr,
    most: int,
    sample: Callable[[zenoh.Sample], None],
    over: Callable[[], None],
) -> None:
    """Ask a publisher, by the key of its token, for its newest samples; ``over`` is called after the last of them.

    Both are called on zenoh's own thread.
    """

    def reply(one: zenoh.Reply) -> None:
        if one.ok is not None:
            sample(one.ok)

    with contextlib.suppress(zenoh.ZError):  # where it fails, its hold ends by time
        session.get(
            f"{token_key}?_max={most};_anyke",  # the publisher's cache takes both parameters
            handlers.Callback(reply, drop=over, indirect=False),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
