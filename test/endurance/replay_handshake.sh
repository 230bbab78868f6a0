#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Run the live validation test COUNT times (default 100) beside one busy process per core; print the number of passes.
set -eu
count=${1:-100}
cd "$(dirname "$0")/../.."
busy=""
for _ in $(seq "$(nproc)"); do
    sh -c 'while :; do :; done' &
    busy="$busy $!"
done
trap 'kill $busy' EXIT
trap 'exit 1' INT TERM
passed=0
for run in $(seq "$count"); do
    if timeout 120 .venv/bin/pytest -q -n0 -o faulthandler_timeout=100 test/nodes/test_validator_twin.py >"/tmp/replay_handshake.$$" 2>&1; then
        passed=$((passed + 1))
    else
        cat "/tmp/replay_handshake.$$"
    fi
    echo "$passed of $run runs passed"
done
rm -f "/tmp/replay_handshake.$$"
[ "$passed" -eq "$count" ]
