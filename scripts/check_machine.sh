#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Check the requirements of the set-up; print the Python to use, or print one line and exit with 2.
# usage: check_machine.sh DIRECTORY [PYTHON]   DIRECTORY: location of the environment; PYTHON: the only one to accept
set -u
directory=$1
wanted=${2:-}

refuse() {
    echo "scara_effmass: $1" >&2
    exit 2
}

[ "$(uname -sm)" = "Linux x86_64" ] ||
    refuse "machine = $(uname -sm): must be Linux x86_64 for the ROS wheels; build in a ROS 2 Jazzy workspace with colcon"

version='import sys; print("%d.%d" % sys.version_info[:2])'
python=
seen=
for candidate in ${wanted:-python3 python3.12 python3.11 python3.13 python3.10}; do
    found=$("$candidate" -c "$version" 2>/dev/null) || continue
    seen="${seen:+$seen, }$candidate is $found"
    case $found in
        3.10 | 3.11 | 3.12 | 3.13) python=$candidate && break ;;
    esac
done
[ -n "$python" ] ||
    refuse "${seen:-no ${wanted:-python3} found}: must be Python 3.10 to 3.13; choose one with 'make PYTHON=python3.12'"

"$python" -c 'import ensurepip, venv' 2>/dev/null ||
    refuse "$python has no venv module: install it (Debian, Ubuntu: apt install python3-venv)"
header=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h
[ -f "$header" ] ||
    refuse "$header is missing: install the headers of $python (Debian, Ubuntu: apt install python3-dev)"

echo 'int main(void) { return 0; }' | ${CC:-cc} -x c -o /dev/null - 2>/dev/null ||
    refuse "no working C compiler (${CC:-cc}): install gcc (Debian, Ubuntu: apt install build-essential) or set CC"
printf '#include <string>\nint main() { return 0; }\n' | ${CXX:-c++} -x c++ -o /dev/null - 2>/dev/null ||
    refuse "no working C++ compiler (${CXX:-c++}): install g++ (Debian, Ubuntu: apt install build-essential) or set CXX"

free=$(df -Pk "$directory" | awk 'NR == 2 { print $4 }')
[ "$free" -ge 2097152 ] ||
    refuse "$directory: free disk space = $((free / 1024)) MB: must be at least 2048 MB"

echo "$python"
