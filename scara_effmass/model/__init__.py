"""Mechanics: what mass a serial robot presents at a contact point along a direction. Pure; SI units."""
