# SPDX-License-Identifier: Apache-2.0
"""Load the compiled kernel while the monitor computes with the reference."""

import gc
import sys
import threading
from collections.abc import Callable

from scara_effmass.safety import Monitor

_SWITCH_S = 1e-4
"""Longest time for which the loading thread may keep the interpreter [s]; a joint state waits for it."""
_END_S = 1.0
"""Longest time for which the end of the node waits for the thread [s]; a cached kernel loads in 1.5 s."""


class KernelLoader:
    """Loads the kernel of a monitor in a thread, compiles it if it is not cached, and switches to it if it agrees."""

    def __init__(self, lock: threading.Lock, log: Callable[[str], object]) -> None:
        """Hold `lock` while using the monitor; pass to `log` what computes from then on."""
        self._lock, self._log = lock, log
        self._monitor: Monitor | None = None
        self._thread: threading.Thread | None = None

    def load(self, monitor: Monitor | None) -> None:
        """Load the kernel if `monitor` lacks it; None: load none from now on. The caller holds the lock."""
        self._monitor = monitor
        if self._thread is None and monitor is not None and monitor.lacks_kernel:
            self._thread = threading.Thread(target=self._run, name="kernel", daemon=True)
            self._thread.start()

    def end(self) -> None:
        """Stop loading; a compiler at work ends with the process. The caller does not hold the lock."""
        with self._lock:
            self._monitor, thread = None, self._thread
        if thread is not None:
            thread.join(_END_S)

    def _run(self) -> None:
        while True:
            with self._lock:
                monitor = self._monitor
                if monitor is None or not monitor.lacks_kernel:
                    self._thread = None
                    return
                present = monitor.assessor
            assessor = present.copy()
            interval = sys.getswitchinterval()
            sys.setswitchinterval(_SWITCH_S)
            gc.disable()  # a collection among the modules of numba takes 50 ms
            try:
                assessor.load_kernel()
            finally:
                gc.freeze()
                gc.enable()
                sys.setswitchinterval(interval)
            with self._lock:
                if self._monitor is monitor and monitor.assessor is present:
                    monitor.assessor = assessor
                    self._log(f"computing with: {monitor.core}")
