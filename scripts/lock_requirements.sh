#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Write the locked files of requirements/, with hashes, for all supported Pythons; usage: lock_requirements.sh PYTHON
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
lock pyproject.toml "$build" --group build --extra dev --output-file requirements/test.lock
# What `make setup` and the demo need. The other files take their versions from the first.
lock pyproject.toml "$build" --group build --extra dashboard --extra reports --extra sim \
    --constraint requirements/test.lock --output-file requirements/setup.lock
lock pyproject.toml "$build" --group build --group colcon --constraint requirements/test.lock \
    --output-file requirements/colcon.lock
lock --group tools --output-file requirements/tools.lock
lock --group uv --output-file requirements/uv.lock
