"""`python -m scara_effmass.sim -o bags`: generate the shipped recordings."""

import argparse
import sys
from pathlib import Path

from scara_effmass.errors import EffmassError
from scara_effmass.sim.generate import generate


def main() -> int:
    """Generate the recordings; return 0, or 2 with one line on stderr."""
    parser = argparse.ArgumentParser(prog="python -m scara_effmass.sim", description="Generate the shipped recordings.")
    parser.add_argument("-o", dest="folder", type=Path, required=True, help="output folder")
    parser.add_argument("--force", action="store_true", help="replace existing recordings")
    options = parser.parse_args()
    try:
        for path in generate(options.folder, overwrite=options.force):
            print(path)  # noqa: T201 - a command prints
    except EffmassError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
