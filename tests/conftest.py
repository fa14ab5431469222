"""What holds for every test."""

from __future__ import annotations

import os

# Workers run beside each other, so each one's linear algebra keeps to one thread; it must be said before numpy loads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from hypothesis import settings

# The same examples on every run, so that a change is judged and not the draw; HYPOTHESIS_PROFILE=explore draws anew.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))
