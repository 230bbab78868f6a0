#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Build sdist and wheel in FOLDER and use the wheel, built from the sdist, in a clean environment outside the tree.
# usage: check_dist.sh PYTHON FOLDER   PYTHON: with the requirements of the build
set -eu
python=$(cd "$(dirname "$1")" && pwd)/$(basename "$1")
root=$(cd "$(dirname "$0")/.." && pwd)
rm -rf "$2"
mkdir -p "$2/elsewhere"
cd "$2"
(cd "$root" && "$python" -c "import sys; from scikit_build_core import build; build.build_sdist(sys.argv[1])" "$OLDPWD")
"$python" -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir . ./*.tar.gz
"$python" -m venv venv
venv/bin/python -m pip install --quiet ./*.whl
cd elsewhere
../venv/bin/scara-effmass doctor
../venv/bin/scara-effmass limits --mass 2.77 --region chest
../venv/bin/scara-effmass assess ../venv/share/scara_effmass/bags/tour -o tour.parquet
ls -l ..
