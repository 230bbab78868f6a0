# SPDX-License-Identifier: Apache-2.0
"""Real-time scheduling and locked memory for this process, where the machine permits them."""

import ctypes
import os
import resource
from pathlib import Path

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
"""Flags of mlockall(2). Without the last one each thread would lock its whole stack of 8 MB."""


def use_realtime(priority: int) -> str:
    """Run all threads of this process under SCHED_FIFO at `priority` (1-99), later ones too, and lock its memory.

    Return why part of it is refused, or "".
    """
    refused = []
    try:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        refused.append(f"SCHED_FIFO needs rtprio {priority}")
    _, limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (limit, limit))
    if ctypes.CDLL(None).mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT):
        refused.append("locked memory needs memlock unlimited")
    return f"{', '.join(refused)} in /etc/security/limits.conf" if refused else ""
