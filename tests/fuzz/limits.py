"""What one input may cost."""

from __future__ import annotations

LONGEST = 1 << 16
"""Inputs grow no longer than this [bytes]: six times the longest message, and enough for any file of the corpus."""

HANG_S = 5.0
"""Processor time [s] that one input may take: a hundred times what the slowest sound one does."""

MOST_MB = 512
"""Memory [MB] that all inputs together may add to the process."""
