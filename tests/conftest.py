"""What all tests share: property tests draw the same examples every time, so a red suite stays red until mended."""

from hypothesis import settings

settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")
