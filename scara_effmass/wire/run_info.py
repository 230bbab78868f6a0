# SPDX-License-Identifier: Apache-2.0
"""Convert run information to and from CDR (`RunInfo.msg`)."""

from scara_effmass.values import RunInfo
from scara_effmass.wire.cdr import decode, encode


def run_info_message(info: RunInfo) -> bytes:
    """Return the CDR bytes of a RunInfo."""
    return encode("RunInfo", info._asdict())


def decode_run_info(data: bytes) -> RunInfo:
    """Return the RunInfo in `data` (CDR of either byte order), unchecked. Raises DecodeError."""
    return RunInfo(**decode(data, "RunInfo"))
