"""``magcal send``: a command for a running daemon, and its answer; 0 carried out, 2 refused or not reached."""

from __future__ import annotations

import argparse
import json
import math
from typing import TYPE_CHECKING, Final

from magcal_service.base.errors import MISSING, ConfigError, Fault, Lacking
from magcal_service.base.typed_toml import nearest
from magcal_service.cli.asking import LONGEST_SOURCE, Desk, NotReachedError, add_where, whom
from magcal_service.cli.common import DONE, REFUSED, Parser
from magcal_service.wire.fields import NAME, NAME_LENGTH

if TYPE_CHECKING:
    from magcal_service.daemon.command_table import CommandSpec
    from magcal_service.links import Link
    from magcal_service.wire.messages import CommandReply

SOURCE: Final = "send"
"""Who gives the command where ``--as`` does not say it."""


def add_send(parser: Parser) -> None:
    """The arguments of ``magcal send``."""
    parser.add_argument("craft", metavar="CRAFT", help="whose")
    parser.add_argument("name", metavar="COMMAND", help="one of those below")
    parser.add_argument(
        "arguments", nargs="*", default=[], metavar="KEY=VALUE", help="its arguments, none where it needs none"
    )
    add_where(parser)
    parser.add_argument(
        "--as", dest="source", default=SOURCE, metavar="NAME", help="who gives it, for the daemon's log"
    )
    parser.add_argument("--json", action="store_true", help="the answer as one JSON object")
    parser.more = commands_text
    parser.examples = ("magcal send paper process_noise bias_nt=0.05 --link zenoh:tcp/127.0.0.1:7447",)
    parser.set_defaults(command=_send)


def commands_text() -> str:
    """Every command with its arguments and what it does, for the help."""
    from magcal_service.daemon.command_table import COMMANDS, WHICH

    lines = []
    for name, spec in COMMANDS.items():
        lines.append(f"  {name:<14}  {spec.does}")
        lines += [f"  {'':<14}    {key}=VALUE: {one.accepted}" for key, one in spec.arguments.items()]
    every = f"Where a craft has several magnetometers, {WHICH}=NAME gives a command to one of them alone."
    sealed = '--link "serial:/dev/ttyUSB0?key=line.key&counter=line.counter" seals what it sends.'
    return "\ncommands:\n" + "\n".join(lines) + f"\n\n{every}\n{sealed}\n"


def _send(options: argparse.Namespace) -> int:
    from magcal_service.links import Role, open_link

    arguments = request(options.name, options.arguments)
    craft = _name("CRAFT", options.craft)
    _name("--as", options.source, LONGEST_SOURCE)
    address, _ = whom(options, [craft], "CRAFT")
    with open_link(address, Role.VIEWER, crafts=[craft]) as link:
        before, reply = _answered(link, craft, options, arguments)
    if options.json:
        told = {"craft": craft, "command": options.name, "arguments": arguments, "accepted": reply.accepted}
        print(json.dumps({**told, "text": reply.text, "before": before.text}, indent=1))
    else:
        print(_as_text(craft, options.name, before, reply))
    return DONE if reply.accepted else REFUSED


def _answered(
    link: Link, craft: str, options: argparse.Namespace, arguments: dict[str, str | int | float | bool]
) -> tuple[CommandReply, CommandReply]:
    """How the craft was before, and the answer; both the same where the daemon takes no command from here.

    What changes something is sent once, when the daemon is known to be there.
    """
    from magcal_service.links.silence import why_silent

    desk = Desk(link, options.source)
    before = desk.reach(craft, options.timeout)
    if before is None:
        raise NotReachedError(f"no answer of craft {craft} on {link.address}: {why_silent(link, [craft])}")
    if not before.accepted or (options.name == "status" and not arguments):
        return before, before
    reply = desk.answer(craft, desk.give(craft, options.name, arguments), options.timeout)
    if reply is None:
        raise NotReachedError(
            f"craft {craft} was reached on {link.address}, and {options.name} was not answered within "
            f"{options.timeout:g} s; it may have been carried out: ask magcal status"
        )
    return before, reply


def _as_text(craft: str, name: str, before: CommandReply, reply: CommandReply) -> str:
    lines = [f"{craft}: {name} {'accepted' if reply.accepted else 'REFUSED'}: {reply.text}"]
    if reply.accepted and reply is not before:
        lines.append(f"  before: {before.text}")
    return "\n".join(lines)


def request(name: str, given: list[str]) -> dict[str, str | int | float | bool]:
    """The arguments of a command as they are sent.

    Parameters
    ----------
    name: of the command.
    given: each as ``KEY=VALUE``.

    Raises ``ConfigError``: an unknown command or argument with the nearest that is known, one that is given twice, no
    number where one is needed, a needed one that is missing.
    """
    from magcal_service.daemon.command_table import COMMANDS

    spec = COMMANDS.get(name)
    if spec is None:
        raise ConfigError([Fault("COMMAND", name, nearest(name, COMMANDS))])
    faults, found = list[Fault](), dict[str, str | int | float | bool]()
    for one in given:
        key, is_pair, value = one.partition("=")
        if not is_pair:
            faults.append(Fault(name, one, "KEY=VALUE is accepted"))
        elif key in found:
            faults.append(Fault(f"{name}: {key}", value, "it is given twice; give it once"))
        else:
            _take(name, spec, key, value, found, faults)
    missing = [key for key, one in spec.arguments.items() if one.is_needed and key not in found]
    faults += [Lacking(f"{name}: {key}", MISSING, f"{spec.arguments[key].accepted} is accepted") for key in missing]
    if faults:
        raise ConfigError(faults)
    return found


def _take(
    name: str, spec: CommandSpec, key: str, value: str, found: dict[str, str | int | float | bool], faults: list[Fault]
) -> None:
    from magcal_service.daemon.command_table import WHICH

    known = [*spec.arguments, WHICH]
    argument = spec.arguments.get(key)
    if key not in known:
        faults.append(Fault(name, key, f"unknown argument; {nearest(key, known)}"))
    elif argument is None or not argument.is_number:
        found[key] = value
    else:
        try:
            found[key] = float("nan" if "_" in value else value)
        except ValueError:
            found[key] = math.nan
        if not math.isfinite(float(found[key])):
            faults.append(Fault(f"{name}: {key}", value, f"{argument.accepted} is accepted"))


def _name(field: str, value: str, longest: int = NAME_LENGTH) -> str:
    if not NAME.fullmatch(value) or len(value) > longest:
        raise ConfigError([Fault(field, value, f"1 to {longest} letters, digits, _ and - are accepted")])
    return value
