"""What holds for all tests."""

from __future__ import annotations

from hypothesis import settings

# A busy machine is no failure, and a failure must come back when it is looked into.
settings.register_profile("same_every_time", deadline=None, derandomize=True)
settings.load_profile("same_every_time")
