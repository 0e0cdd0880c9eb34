"""Robots and objects from other tools' files, as arms and props that a rig can place."""

from trocar.apps.foreign.bring import Imported, Order, bring_in

__all__ = ["Imported", "Order", "bring_in"]
