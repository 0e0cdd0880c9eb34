"""Older interfaces that scripts were written for, served beside the dVRK's own."""

from trocar.interfaces.crtk.compat.table import Compatible, compatible

__all__ = ["Compatible", "compatible"]
