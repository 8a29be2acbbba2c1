"""A link's address: ``scheme:rest?option=value&option=value``.

``parse_address`` splits the text; the link reads each option with a typed method and then calls ``finish``, which
refuses what nobody read.  Values may be percent-encoded, so that a path can hold ``&`` or ``=``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final, NoReturn
from urllib.parse import unquote

from magcal_service.base.errors import MISSING, LinkAddressError
from magcal_service.base.typed_toml import nearest

SCHEMES: Final = ("zenoh", "serial", "loop", "recording", "ccsds")
"""What may stand before the colon; ``links`` has the link of each."""

OUTPUT_SCHEMES: Final = ("ccsds",)
"""Those that only send: for ``[output] links``, and no daemon's main link."""

_SCHEME = re.compile(r"[a-z][a-z0-9]*")
_OPTION = re.compile(r"[a-z][a-z0-9_]*")
_MAX_LENGTH = 4096  # characters: as long as a path may be on Linux (PATH_MAX); refusals quote what is within it


class LinkAddress:
    """One parsed address being read by its link.

    Parameters
    ----------
    text: the whole address as written.
    scheme: what stands before the first colon, such as ``"zenoh"``.
    rest: what stands between the colon and the question mark.
    options: option names with their decoded values.
    """

    def __init__(self, text: str, scheme: str, rest: str, options: dict[str, str]) -> None:
        self.text, self.scheme, self.rest = text, scheme, rest
        self._options = options
        self._known: set[str] = set()

    def __str__(self) -> str:
        return self.text

    def refuse(self, what: str, value: object, accepted: str) -> NoReturn:
        """Raise ``LinkAddressError`` about one part of this address."""
        raise LinkAddressError(f"link address {self.text!r}: {what} is {value!r}; {accepted}")

    def lack(self, what: str, accepted: str) -> NoReturn:
        """Raise ``LinkAddressError`` about a part that this address does not have."""
        raise LinkAddressError(f"link address {self.text!r}: {what} is {MISSING}; {accepted}")

    def has(self, name: str) -> bool:
        """Whether the option is given (it still has to be read by a typed method)."""
        self._known.add(name)
        return name in self._options

    def text_of(self, name: str, default: str, pattern: str = r".+", accepted: str = "any text") -> str:
        """A text that matches ``pattern`` as a whole."""
        if not self.has(name):
            return default
        value = self._options[name]
        if not re.fullmatch(pattern, value):
            self.refuse(name, value, f"{accepted} is accepted")
        return value

    def choice(self, name: str, accepted: Sequence[str], default: str) -> str:
        """One of the ``accepted`` words."""
        if not self.has(name):
            return default
        value = self._options[name]
        if value not in accepted:
            self.refuse(name, value, nearest(value, accepted))
        return value

    def flag(self, name: str, default: bool) -> bool:
        """``yes`` or ``no``."""
        return self.choice(name, ("yes", "no"), "yes" if default else "no") == "yes"

    def integer(self, name: str, default: int, minimum: int, maximum: int) -> int:
        """A whole number within [minimum, maximum], in decimal digits."""
        if not self.has(name):
            return default
        value = self._options[name]
        if not re.fullmatch(r"[0-9]{1,12}", value) or not minimum <= int(value) <= maximum:
            self.refuse(name, value, f"a whole number from {minimum} to {maximum} is accepted")
        return int(value)

    def real(self, name: str, default: float, minimum: float, maximum: float) -> float:
        """A finite number within [minimum, maximum]."""
        if not self.has(name):
            return default
        value = self._options[name]
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not minimum <= number <= maximum:
            self.refuse(name, value, f"a number from {minimum:g} to {maximum:g} is accepted")
        return number

    def finish(self) -> None:
        """Refuse every option that no method has asked for."""
        for name in self._options:
            if name not in self._known:
                self.refuse("option", name, f"{self.scheme} links have no such option; {nearest(name, self._known)}")


def parse_address(text: str) -> LinkAddress:
    """Split an address into scheme, rest and options.

    Raises
    ------
    LinkAddressError: where there is no scheme or an unknown one, or an option is malformed or given twice.
    """
    if len(text) > _MAX_LENGTH or not text.isprintable():
        raise LinkAddressError(f"a link address has at most {_MAX_LENGTH} printable characters; got {text[:80]!r}")
    scheme, colon, remainder = text.partition(":")
    if not colon or not _SCHEME.fullmatch(scheme):
        raise LinkAddressError(
            f"link address {text!r} has no scheme; an address such as 'zenoh:tcp/127.0.0.1:7447' is accepted"
        )
    rest, _, query = remainder.partition("?")
    address = LinkAddress(text, scheme, rest, {})
    if rest.startswith("//"):
        address.refuse("the part after the scheme", rest, "it is written without the two slashes")
    address._options.update(_options(address, query))
    if scheme not in SCHEMES:
        raise LinkAddressError(f"link address {text!r}: unknown scheme; {nearest(scheme, SCHEMES)}")
    return address


def _options(address: LinkAddress, query: str) -> dict[str, str]:
    options: dict[str, str] = {}
    for part in query.split("&") if query else ():
        name, equals, value = part.partition("=")
        if not equals or not value or not _OPTION.fullmatch(name):
            address.refuse("option", part, "name=value is accepted")
        if name in options:
            address.refuse("option", name, "each option once is accepted")
        options[name] = unquote(value, errors="replace")
    return options
