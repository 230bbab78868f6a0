"""Generate the shipped recordings: the reference recordings and one repetition of the campaign."""

import hashlib
from pathlib import Path

from scara_effmass.errors import OutputError
from scara_effmass.sim.campaign import Campaign, run_campaign
from scara_effmass.sim.recording_writer import write_recording
from scara_effmass.sim.recordings import EPOCH_NS, RECORDINGS, REVISION, SEED, ReferenceRecording
from scara_effmass.sim.synthetic_force import BLOCK_NS
from scara_effmass.values import RunInfo

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
    bags = []
    for recording in RECORDINGS:
        blocks = ((block.stamp_ns + BLOCK_NS, block) for block in recording.force_blocks())
        path = folder / recording.name
        write_recording(path, run_info(recording), recording.states(), blocks, overwrite=overwrite)
        bags.append(path)
    bags += [step.path for step in run_campaign(folder / CAMPAIGN_FOLDER, CAMPAIGN, overwrite=overwrite)]
    files = sorted(file for bag in bags for file in bag.iterdir())
    lines = [f"{hashlib.sha256(f.read_bytes()).hexdigest()}  {f.relative_to(folder).as_posix()}\n" for f in files]
    try:
        checksums.write_text("".join(lines), encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{checksums}: cannot be written: {error.strerror}") from None
    return (*bags, checksums)


def run_info(recording: ReferenceRecording) -> RunInfo:
    """Return the run information of a reference recording, with the pulses of its force."""
    lines = [
        recording.description,
        f"generator = python -m scara_effmass.sim, revision = {REVISION}, seed = {SEED}",
        *(
            f"contact at {pulse.onset_s} s: peak {pulse.peak_force} N, duration {pulse.duration} s, "
            f"impulse {pulse.impulse} N s, rebound {pulse.rebound}"
            for pulse in recording.pulses
        ),
    ]
    return RunInfo(stamp_ns=EPOCH_NS, simulated=True, note="\n".join(lines))
