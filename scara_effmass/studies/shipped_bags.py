# SPDX-License-Identifier: Apache-2.0
"""Generate the reference recordings and one repetition of the campaign.

python -m scara_effmass.studies.shipped_bags -o bags
"""

import argparse
import hashlib
import sys
from pathlib import Path

from scara_effmass.errors import EffmassError, OutputError
from scara_effmass.sim.recordings import RECORDINGS
from scara_effmass.studies.campaign import Campaign, run_campaign

CHECKSUMS = "SHA256SUMS"
CAMPAIGN = Campaign(repetitions=1)
CAMPAIGN_FOLDER = "campaign"


def generate(folder: Path, *, overwrite: bool = False) -> tuple[Path, ...]:
    """Write all shipped recordings into `folder`, with checksums; return the paths.

    The same versions of the libraries give the same bytes. Raises OutputError.
    """
    checksums = folder / CHECKSUMS
    if checksums.exists() and not overwrite:
        raise OutputError(f"{checksums}: already exists; use --force to replace it")
    bags = [recording.write(folder, overwrite=overwrite) for recording in RECORDINGS]
    bags += [step.path for step in run_campaign(folder / CAMPAIGN_FOLDER, CAMPAIGN, overwrite=overwrite)]
    files = sorted(file for bag in bags for file in bag.iterdir())
    lines = [f"{hashlib.sha256(f.read_bytes()).hexdigest()}  {f.relative_to(folder).as_posix()}\n" for f in files]
    try:
        checksums.write_text("".join(lines), encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{checksums}: cannot be written: {error.strerror}") from None
    return (*bags, checksums)


def main() -> int:
    """Generate the recordings; return 0, or 2 with one line on stderr."""
    parser = argparse.ArgumentParser(description="Generate the shipped recordings.")
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
