# SPDX-License-Identifier: Apache-2.0
"""Recordings: the only room that knows MCAP, SQLite and ROS 1 bags."""
