# SPDX-License-Identifier: Apache-2.0
"""Standard streams for a process that was started without them, as some supervisors do."""

import os
import sys


def open_standard_streams() -> None:
    """Connect stdin, stdout and stderr to the null device where they are closed.

    Otherwise the next file or socket would get the free descriptor, and libraries would print into it.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:  # open returns the lowest free one
        os.set_inheritable(descriptor, True)  # noqa: FBT003
    os.close(descriptor)
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115 - lives as long as the process
