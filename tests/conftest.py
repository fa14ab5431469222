"""What holds for every test."""

from __future__ import annotations

import os

from hypothesis import settings

# The same examples on every run, so that a change is judged and not the draw; HYPOTHESIS_PROFILE=explore draws anew.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))
