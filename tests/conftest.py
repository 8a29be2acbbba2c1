"""What all tests share: property tests draw the same examples every time, so a red suite stays red until mended."""

import gc
import logging
import os
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(  # times of the clock would fail tests on a machine that does other work as well
    "repeatable", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("repeatable")


pytest.register_assert_rewrite("tests.links.link_contract", "tests.links.link_messages")


@pytest.fixture(autouse=True)
def _level_of_the_log() -> Iterator[None]:
    """A command that a test runs in its own process sets the root's level, and others would log more than theirs."""
    level = logging.getLogger().level
    yield
    if logging.getLogger().level != level:  # to set it makes every logger forget what it knows
        logging.getLogger().setLevel(level)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Ten thousand tests and what they import stay to the end: no search for garbage goes through them."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Three processes for two cores, for many tests wait for a daemon, a link or a child and use none."""
    return (3 * (os.cpu_count() or 1) + 1) // 2
