# SPDX-License-Identifier: Apache-2.0
"""End a process together with its parent."""

import ctypes
import signal

_PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """Have Linux send SIGTERM to this process when its parent dies, even by SIGKILL.

    So no node outlives a demo, and no worker outlives its command.
    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
