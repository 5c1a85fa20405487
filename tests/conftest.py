"""What all tests need."""

from __future__ import annotations

import signal

import properties  # registers the profiles before pytest looks for the one it is told
from hypothesis import settings

settings.load_profile("suite")
assert properties.FUZZ != settings.get_current_profile_name()

signal.signal(signal.SIGINT, signal.default_int_handler)
"""Where the tests run in the background, Ctrl-C is ignored, and what they start would inherit that."""
