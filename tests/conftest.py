"""What all tests need."""

from __future__ import annotations

import contextlib
import io
import os
import signal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read as numpy is imported; a worker per core keeps all cores busy
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

import properties  # registers the profiles before pytest looks for the one it is told
from hypothesis import settings

from beltarm_env import jit

settings.load_profile("suite")
assert properties.FUZZ != settings.get_current_profile_name()

with contextlib.redirect_stderr(io.StringIO()):
    jit._announce()  # which it does once: an empty cache adds no line to what commands say within this process

signal.signal(signal.SIGINT, signal.default_int_handler)
"""Where the tests run in the background, Ctrl-C is ignored, and what they start would inherit that."""
