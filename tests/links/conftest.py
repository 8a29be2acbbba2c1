"""Full reports for the assertions in the shared modules of the links' tests."""

from __future__ import annotations

import pytest

pytest.register_assert_rewrite("tests.links.link_contract", "tests.links.link_messages")
