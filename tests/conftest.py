"""What all tests need."""

from __future__ import annotations

import signal

signal.signal(signal.SIGINT, signal.default_int_handler)
"""Where the tests run in the background, Ctrl-C is ignored, and what they start would inherit that."""
