# SPDX-License-Identifier: Apache-2.0
"""The wire format: CDR, message conversion, topics and QoS."""
