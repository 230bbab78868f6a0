# SPDX-License-Identifier: Apache-2.0
"""Recordings and message bytes: the only room that knows MCAP, SQLite and ROS 1 bags, and CDR."""
