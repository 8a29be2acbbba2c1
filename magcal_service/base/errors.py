"""Every error this project raises on purpose, as one tree.

A message names the value that was refused, what is accepted, and the next step.  The command line prints
``MagcalError`` texts without a traceback and ends with ``exit_code``.
"""

from __future__ import annotations

import difflib
import errno
from pathlib import Path
from typing import Final

__all__ = [
    "DISTRIBUTION",
    "MISSING",
    "ConfigError",
    "DecodeError",
    "ExtraMissingError",
    "Fault",
    "FileFault",
    "InputRefusedError",
    "Lacking",
    "LinkAddressError",
    "LinkError",
    "MagcalError",
    "RecordingError",
    "how_to_install",
    "printable",
    "unwritable",
    "why_not",
]


class MagcalError(Exception):
    """Root of the tree; ``exit_code`` is what a command ends with when this reaches it."""

    exit_code = 2


_LONGEST_VALUE = 500  # characters of a value in a message: some lines on a terminal, whatever the file holds


def printable(text: str) -> str:
    """A text with everything that a terminal might obey, control characters and the like, shown as an escape."""
    if text.isprintable():
        return text
    return "".join(one if one.isprintable() else one.encode("unicode_escape").decode("ascii") for one in text)


def _shown(value: object) -> str:
    """A value as the user wrote it, cut where it is long; some values of a file have no text at all."""
    try:
        text = repr(value)
    except RecursionError:
        return "a value nested too deeply"
    except ValueError:  # an integer of thousands of digits
        return "a number too large to be shown"
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]} ..."


class Fault:
    """One thing wrong with an input: where, what, and what would have been accepted.

    Parameters
    ----------
    where: file and field, such as ``"flight.toml: magnetometer.unit"``.
    value: the refused value as the user wrote it.
    accepted: what is accepted there, and the next step.
    """

    __slots__ = ("accepted", "value", "where")

    def __init__(self, where: str, value: object, accepted: str) -> None:
        self.where, self.value, self.accepted = where, value, accepted

    def __str__(self) -> str:
        return printable(f"{self.where}: {_shown(self.value)} is refused; {self.accepted}")

    def __repr__(self) -> str:
        return f"Fault({str(self)!r})"


class FileFault(Fault):
    """A file or folder that the operating system does not open, in words: nobody wrote a value there to be refused.

    Parameters
    ----------
    where: the file, or file and field.
    error: what the operating system said.
    accepted: what is expected there, and the next step.
    """

    __slots__ = ()

    def __init__(self, where: str, error: OSError, accepted: str) -> None:
        super().__init__(where, error, accepted)

    @classmethod
    def of_folder(cls, where: str, accepted: str) -> FileFault:
        """The fault of a folder where a file is expected."""
        return cls(where, IsADirectoryError(errno.EISDIR, "a folder"), accepted)

    def __str__(self) -> str:
        meant = _meant(self.value)
        return printable(
            f"{self.where}: {why_not(self.value)}; {f'did you mean {meant}? ' if meant else ''}{self.accepted}"
        )


def _meant(error: object) -> str:
    """The name beside a missing file that is nearest to its own; empty where none is near."""
    if not isinstance(error, FileNotFoundError) or not isinstance(error.filename, str):
        return ""
    path = Path(error.filename)
    try:
        beside = [one.name for one in path.parent.iterdir()]
    except OSError:
        return ""
    return next(iter(difflib.get_close_matches(path.name, beside, n=1)), "")


MISSING: Final = "missing"
"""What ``Lacking`` says of a key or an option that is not given."""


class Lacking(Fault):
    """Something that an input does not hold, in words (``value``): nobody wrote a value there to be refused."""

    __slots__ = ()

    def __str__(self) -> str:
        return printable(f"{self.where}: {self.value}; {self.accepted}")


_WHY_NOT = {
    errno.ENOENT: "there is no such file or folder",
    errno.EEXIST: "a file of this name is there already",
    errno.EISDIR: "this is a folder, not a file",
    errno.ENOTDIR: "a part of this path is a file, not a folder",
    errno.EACCES: "permission is denied to this user",
    errno.EPERM: "this user may not do that",
    errno.ENOSPC: "no space is left on the disk",
    errno.EROFS: "the file system can only be read",
    errno.ELOOP: "this is a link, or too many links lead to it",
    errno.ENAMETOOLONG: "the name is too long for a file",
    errno.EADDRINUSE: "another process has this port",
    errno.EADDRNOTAVAIL: "this machine has no such address",
    errno.ENODEV: "there is no such device",
    errno.ENXIO: "there is no such device",
    errno.EIO: "the disk or device failed",
    errno.ENOTTY: "this is no serial device",
}


def why_not(error: object) -> str:
    """What the operating system said, as a clause with a verb."""
    known = _WHY_NOT.get(error.errno or 0) if isinstance(error, OSError) else None
    if known is not None:
        return known
    said = (error.strerror if isinstance(error, OSError) else None) or str(error)
    return f"the system says {said[:1].lower()}{said[1:]}" if isinstance(error, OSError) and error.errno else said


class InputRefusedError(MagcalError):
    """An input file or argument was refused; carries every fault found, one line each."""

    def __init__(self, faults: list[Fault]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(str(fault) for fault in faults))


class ConfigError(InputRefusedError):
    """A configuration or scenario file was refused."""


class RecordingError(InputRefusedError):
    """A recording or its descriptor was refused."""


def unwritable(path: Path, error: OSError) -> InputRefusedError:
    """The refusal of an output file."""
    if isinstance(error, FileNotFoundError):
        missing = FileNotFoundError(f"there is no folder {path.parent}")
        return InputRefusedError([FileFault(str(path), missing, "make it, or give a file in a folder that is there")])
    return InputRefusedError([FileFault(str(path), error, "give a file that can be written")])


class LinkAddressError(MagcalError):
    """A link address was refused: unknown scheme, missing part, or an option nobody reads."""


class LinkError(MagcalError):
    """A link could not be opened at all (a link that dies later reconnects instead of raising)."""


DISTRIBUTION = "magcal-service"
"""Name on the package index, where ``magcal`` is somebody else's calibrator."""


def how_to_install(extra: str) -> str:
    """The command that adds an extra to this very installation: from the index, a folder, or an editable checkout."""
    from importlib.metadata import PackageNotFoundError, distribution
    from json import loads
    from urllib.parse import unquote, urlsplit

    try:
        origin = loads(distribution(DISTRIBUTION).read_text("direct_url.json") or "{}")
    except PackageNotFoundError:  # run from a checkout that nobody installed
        return f"pip install -e '{Path(__file__).resolve().parents[2]}[{extra}]'"
    url = origin.get("url", "")
    if not url.startswith("file:"):
        return f"pip install '{DISTRIBUTION}[{extra}]'"
    editable = "-e " if origin.get("dir_info", {}).get("editable") else ""
    return f"pip install {editable}'{unquote(urlsplit(url).path)}[{extra}]'"


class ExtraMissingError(MagcalError):
    """A command needs a package that the base installation does not bring."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        super().__init__(f"{purpose} needs the package {package!r}; install it with: {how_to_install(extra)}")


class DecodeError(MagcalError):
    """Bytes that are not an acceptable message; ``reason`` is the counter they fall under.

    Parameters
    ----------
    reason: a short fixed name from ``wire.messages.REFUSALS``.
    detail: the value and what is accepted.
    """

    def __init__(self, reason: str, detail: str) -> None:
        self.reason = reason
        super().__init__(f"{reason}: {detail}")
