"""What all tests share: property tests draw the same examples every time, so a red suite stays red until mended."""

import os

import pytest
from hypothesis import settings

settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Three processes for two cores, for many tests wait for a daemon, a link or a child and use none."""
    return (3 * (os.cpu_count() or 1) + 1) // 2
