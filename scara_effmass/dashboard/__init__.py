# SPDX-License-Identifier: Apache-2.0
"""Web page of a cell for its operator (NiceGUI)."""
