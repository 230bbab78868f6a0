#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Write the three locked requirement files, with hashes, for all supported Pythons; usage: lock_requirements.sh PYTHON
set -eu
python=$1
cd "$(dirname "$0")/.."
build=$(mktemp)
trap 'rm -f "$build"' EXIT
"$python" - > "$build" <<'PYTHON'
try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib
with open("pyproject.toml", "rb") as file:
    print(*tomllib.load(file)["build-system"]["requires"], sep="\n")
PYTHON
lock() {
    "$python" -m uv pip compile --quiet --universal --upgrade --generate-hashes --no-annotate \
        --python-version 3.10 --custom-compile-command "make lock" "$@"
}
lock pyproject.toml "$build" --group build --extra dev --output-file requirements.lock
lock pyproject.toml "$build" --group build --group colcon --constraint requirements.lock \
    --output-file requirements-colcon.lock
lock --group tools --output-file requirements-tools.lock
