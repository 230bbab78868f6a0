# SPDX-License-Identifier: Apache-2.0
"""`python -m scara_effmass` is `scara-effmass`."""

import sys

from scara_effmass.cli import main

if __name__ == "__main__":
    sys.exit(main())
