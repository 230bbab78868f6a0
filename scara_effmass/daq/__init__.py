# SPDX-License-Identifier: Apache-2.0
"""Where measured force comes from, and what is done with the signal until it is newtons with a time."""

from collections.abc import Callable
from pkgutil import resolve_name

from scara_effmass.daq.source import ForceSource
from scara_effmass.errors import DriverMissingError
from scara_effmass.extras import missing_extra
from scara_effmass.settings import DaqSettings, ForceSourceKind

SOURCES: dict[ForceSourceKind, str] = {
    "ni9230": "scara_effmass.daq.ni9230:Ni9230Source",
    "bag": "scara_effmass.daq.bag_source:BagSource",
    "sim": "scara_effmass.daq.sim_source:make_sim_source",
}
"""Constructor of each source; its module, and with it a driver, is imported only when the source is selected."""


def make_source(settings: DaqSettings, now_ns: Callable[[], int]) -> ForceSource:
    """Return the source selected in `settings`; `now_ns` returns the ROS time. Raises DaqError or SettingsError."""
    try:
        source: ForceSource = resolve_name(SOURCES[settings.source])(settings, now_ns)
    except ImportError as error:
        raise DriverMissingError(missing_extra(error) or str(error)) from error
    return source
