# SPDX-License-Identifier: Apache-2.0
"""Robots for the tests of the reference: those of the tests of the model."""

from test.model.conftest import along, load_rows, load_urdf_file, omron, omron_dynamics, omron_file, omron_rows

__all__ = ["along", "load_rows", "load_urdf_file", "omron", "omron_dynamics", "omron_file", "omron_rows"]
