"""Effective mass, impact force and allowable speed of a robot arm, live from its joint states."""

from importlib.metadata import version

__version__ = version("scara_effmass")
