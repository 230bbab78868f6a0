#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# Build the tree as a ROS workspace and check the installation; usage: check_colcon.sh VENV DIRECTORY
set -eu
cd "$(dirname "$0")/.."
venv=$PWD/$1
work=$PWD/$2
export PATH="$venv/bin:$PATH"

build() {
    # The second build keeps the compiled messages, except for the Python package, which it installs in another way.
    rm -rf "$work/install" "$work/log" "$work/build/scara_effmass" "$work/build/scara_effmass_msgs/ament_cmake_python"
    colcon --log-base "$work/log" build --base-paths . msg_schemas "$@" \
        --build-base "$work/build" --install-base "$work/install" --event-handlers console_stderr- \
        --cmake-args -Wno-dev -DBUILD_TESTING=OFF \
        "-DPython3_EXECUTABLE=$venv/bin/python" "-DCMAKE_PROJECT_INCLUDE=$PWD/cmake/ros_wheels.cmake" \
        > "$work.log" 2>&1 || { cat "$work.log"; exit 1; }
}

check() (
    prefix=$work/install/scara_effmass
    messages=$work/install/scara_effmass_msgs
    for path in "$prefix/lib/scara_effmass/monitor_node" \
        "$prefix/share/ament_index/resource_index/packages/scara_effmass" \
        "$prefix/share/scara_effmass/package.xml" \
        "$messages/share/scara_effmass_msgs/package.xml" \
        "$messages/share/scara_effmass_msgs/msg/ContactState.msg"; do
        [ -e "$path" ] || { echo "colcon: $path was not installed" >&2; exit 1; }
    done
    for folder in bags config launch; do
        diff -r -x __pycache__ "$folder" "$prefix/share/scara_effmass/$folder" || exit 1
    done
    set +u  # local_setup.sh reads variables that may be unset
    . "$work/install/local_setup.sh"
    cd /
    ROS_DOMAIN_ID=$((100 + $$ % 100)) python - "$prefix/lib/scara_effmass/monitor_node" <<'PYTHON'
import signal
import subprocess
import sys
import time

import rclpy
from rclpy.serialization import deserialize_message, serialize_message
from scara_effmass.share import share
from scara_effmass_msgs.msg import ContactState

state = deserialize_message(serialize_message(ContactState(speed=0.25)), ContactState)
assert state.speed == 0.25, state
assert share("config", "omron_i4_550l.yaml").is_file()

rclpy.init()
node = rclpy.create_node("colcon_check")
with subprocess.Popen([sys.argv[1]]) as monitor:
    deadline = time.monotonic() + 30.0
    while len(node.get_node_names()) < 2 and monitor.poll() is None and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
    names = node.get_node_names()
    monitor.send_signal(signal.SIGINT)
assert len(names) == 2, f"monitor_node did not appear, there are only {names}"
assert monitor.returncode == 0, f"monitor_node ended with {monitor.returncode}"
rclpy.shutdown()
PYTHON
)

# A workspace with another package: with the link of README.md, plain colcon finds all of them.
check_list() {
    other=$work/workspace/src/other
    mkdir -p "$other"
    sed "s/<name>scara_effmass_msgs/<name>other/" msg_schemas/package.xml > "$other/package.xml"
    cp msg_schemas/CMakeLists.txt "$other"
    ln -s "$PWD" "$work/workspace/src/scara_effmass"
    ln -s scara_effmass/msg_schemas "$work/workspace/src/scara_effmass_msgs"
    names=$(cd "$work/workspace" && colcon --log-base /dev/null list --names-only | sort | tr '\n' ' ')
    [ "$names" = "other scara_effmass scara_effmass_msgs " ] || { echo "colcon list: found $names" >&2; exit 1; }
    rm -rf "$work/workspace"
}

rm -rf "$work"
mkdir -p "$(dirname "$work")"
check_list
for option in "" --symlink-install; do
    build $option
    check
    echo "colcon: build${option:+ $option} is complete"
done
