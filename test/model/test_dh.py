"""DH files: what they say is what is read, and whatever is wrong is named in one line."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from conftest_paths import OMRON
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scara_effmass.errors import RobotError
from scara_effmass.model.arm import Arm
from scara_effmass.model.dh import load_dh

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from scara_effmass.model.robot import Robot
