"""Full reports for the assertions in the shared modules of the links' tests."""

from __future__ import annotations

import pytest

pytest.register_assert_rewrite("link_contract", "link_messages")
