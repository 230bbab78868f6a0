# SPDX-License-Identifier: Apache-2.0
"""Standard streams of a process that was started without them, as by some supervisors."""

import os
import sys


def open_standard_streams() -> None:
    """Connect each of stdin, stdout and stderr that is closed with the null device.

    Otherwise the next file or socket gets its descriptor, and what libraries print ends up there.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:  # the lowest free one
        os.set_inheritable(descriptor, True)  # noqa: FBT003
    os.close(descriptor)
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115 - lives as long as the process
