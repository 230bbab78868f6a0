#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Install a locked file of requirements, with its hashes, by uv; by pip where uv cannot be fetched or fails.
# usage: install_locked.sh VENV LOCK
set -eu
venv=$1
lock=$2
fetch() { "$venv/bin/python" -m pip install --quiet --no-deps --no-compile --require-hashes "$@"; }
if { [ -x "$venv/bin/uv" ] || fetch --retries 1 --requirement "$(dirname "$lock")/uv.lock"; } &&
    "$venv/bin/uv" pip install --quiet --python "$venv/bin/python" --no-deps --require-hashes --requirement "$lock"; then
    exit
fi
echo "uv cannot install $lock: pip does, which takes a minute longer" >&2
fetch --use-pep517 --requirement "$lock"
