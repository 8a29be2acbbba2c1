"""Why nobody answers at the other end of a link, and what there is instead, in words for people."""

from __future__ import annotations

from collections.abc import Collection

from magcal_service.links.base import Link

__all__ = ["why_silent"]


def why_silent(link: Link, crafts: Collection[str] = (), *, heard: bool = False) -> str:
    """What keeps answers away, as far as this end can tell.

    Parameters
    ----------
    link: an open link, as a node or a viewer has it.
    crafts: whose answers are missed; of any where empty.
    heard: whether the daemon has told this end its status, so that it is only silent since.
    """
    alone, served = link.alone, link.served()
    if alone and served is None:
        return f"{alone}; give the device opposite the daemon's, or see the daemon's log and metrics (docs/health.md)"
    if alone:
        return f"{alone}; is the daemon running?"
    if served is None:
        said = "; ".join(link.warnings) or "nothing has come over the line"
        return f"{said}; is the daemon running at its other end?"
    if not served:
        return "no daemon is seen there; is the daemon running, and do its access rules let this end see it?"
    names, unknown = ", ".join(sorted(served)), sorted(set(crafts) - served)
    if unknown:
        return f"no daemon there serves craft {', '.join(unknown)}; served: {names}"
    if heard:
        return f"a daemon there serves {names} and has sent nothing new: ask magcal status whether samples reach it"
    return (
        f"a daemon there serves {names} and does not answer: its access rules may keep this end out, or it refuses "
        "what comes; its log and the counters link.denied.*, link.refused.* of its status say which"
    )
