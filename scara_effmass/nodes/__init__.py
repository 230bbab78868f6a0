# SPDX-License-Identifier: Apache-2.0
"""Who runs it live: the ROS 2 nodes. The only room that knows rclpy."""
