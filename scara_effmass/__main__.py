# SPDX-License-Identifier: Apache-2.0
"""`python -m scara_effmass` and `scara-effmass`."""

import sys

from scara_effmass.streams import open_standard_streams


def main() -> int:
    """Run the command line; Ctrl-C gives one line and exit code 130, also while modules are imported."""
    open_standard_streams()
    try:
        from scara_effmass.cli import main as run  # noqa: PLC0415 - takes a second

        return run()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)  # noqa: T201
        return 130


if __name__ == "__main__":
    sys.exit(main())
