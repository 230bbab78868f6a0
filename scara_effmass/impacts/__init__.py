"""Impacts: found in the force signal. Pure: the same live and offline."""
