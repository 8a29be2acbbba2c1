"""A service whose link's threads get no processor while others want it: bursts of vectors, in a process of its own.

``python -m tests.links.starved_service ADDRESS BURSTS VECTORS``; it begins once a node is there.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from typing import cast

from magcal_service.links import Role, open_link
from magcal_service.links.zenoh import ZenohLink
from tests.links.link_messages import vector

HOGS = 4


def starve() -> None:
    """Every thread but this one runs only where nobody else wants to."""
    for thread in map(int, os.listdir("/proc/self/task")):
        if thread != os.getpid():
            os.sched_setscheduler(thread, os.SCHED_IDLE, os.sched_param(0))


def main(address: str, bursts: int, vectors: int) -> None:
    """Wait for the node, then send the bursts beside busy processes."""
    with open_link(address, Role.SERVICE, crafts=["alpha"]) as link:
        while not cast(ZenohLink, link).alive():
            link.receive(0.1)
        starve()
        hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(HOGS)]
        try:
            for number in range(bursts * vectors):
                link.send(vector(number))
                if number % vectors == vectors - 1:
                    time.sleep(0.3)
        finally:
            for hog in hogs:
                hog.kill()
                hog.wait()
        time.sleep(1.0)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
