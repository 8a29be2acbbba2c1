"""Links beside the main one that take what is published as well, such as mission control's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from magcal_service.links import Link, Role, open_link
from magcal_service.wire.messages import Message


class Outputs:
    """Every message that is sent goes to each of them, in order.

    Parameters
    ----------
    addresses: of ``[output] links``.
    crafts: names of the craft that are served.

    Raises as ``open_link``; what is open by then is closed again.
    """

    def __init__(self, addresses: Sequence[str], crafts: Sequence[str]) -> None:
        self._links: list[Link] = []
        try:
            for address in addresses:
                self._links.append(open_link(address, Role.SERVICE, crafts=crafts))
        except BaseException:
            self.close()
            raise

    def send(self, message: Message) -> None:
        """Send one message by all of them; none waits or raises."""
        for link in self._links:
            link.send(message)

    @property
    def counters(self) -> Counter[str]:
        """The sums of the links' counters, as ``output.*``."""
        total = sum((link.counters for link in self._links), Counter[str]())
        return Counter({f"output.{name}": count for name, count in total.items()})

    @property
    def trouble(self) -> str:
        """Which of them nobody listens to, and why; empty where all are well."""
        return "; ".join(f"{link.address}: {link.alone}" for link in self._links if link.alone)

    def close(self) -> None:
        """Close them; may be called twice."""
        for link in self._links:
            link.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()
