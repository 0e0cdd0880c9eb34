"""A tray of blocks beside a rig's arms: many objects, for measuring what they cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.props import check_object_name
from trocar.descriptions.records import Movable, Prop, RigDescription, Shape
from trocar.descriptions.shapes import mass_properties
from trocar.descriptions.table import Table
from trocar.errors import InputError
from trocar.geometry.se3 import transform

Array = NDArray[np.float64]

#: Half edges of a block [m], its mass [kg], from block to block [m]. Source: our own choice: of
#: plastic, as big as what instruments handle.
HALF_M, MASS_KG, APART_M = 0.005, 0.001, 0.02
#: The tray's half thickness, and where its middle is beside the first remote centre or root that
#: stands in the world: out of reach. Source: our own choice. [m]
TRAY_HALF_M, TRAY_AT = 0.01, np.array([1.2, -1.2, -0.2])
MOST = 400


def rig_with_blocks(rig: RigDescription, count: int) -> RigDescription:
    """Return a rig with so many blocks on a tray of their own, called block1, block2, ...

    Raises:
        InputError: the number is not from 1 to `MOST`, or a prop has one of the names
    """
    if not 1 <= count <= MOST:
        raise InputError(f"blocks: got {count!r}; allowed: a whole number from 1 to {MOST}")
    side = int(np.ceil(np.sqrt(count)))
    middle = rig.arms[0].pose[:3, 3] + TRAY_AT
    half = np.array([0.5 * APART_M * (side + 1)] * 2 + [TRAY_HALF_M])
    tray = Prop("tray", transform(np.eye(3), middle), (Shape("box", np.eye(4), half, "drape"),))
    blocks = [_block(number, middle, side) for number in range(count)]
    taken = {prop.name for prop in rig.props} & {"tray", *(block.name for block in blocks)}
    if taken:
        raise InputError(f"blocks: rig {rig.name} has {', '.join(sorted(taken))} already")
    for block in blocks:
        check_object_name(Table({}, rig.file), block.name, [arm.name for arm in rig.arms])
    return replace(rig, props=(*rig.props, tray, *blocks))


def _block(number: int, tray: Array, side: int) -> Prop:
    row, column = divmod(number, side)
    grid = APART_M * (np.array([column, row]) - 0.5 * (side - 1))
    at = tray + np.array([*grid, TRAY_HALF_M + HALF_M])
    shape = Shape("box", np.eye(4), np.full(3, HALF_M), "accent")
    com, inertia = mass_properties([shape], MASS_KG)
    movable = Movable(MASS_KG, com, inertia, "shape")
    return Prop(f"block{number + 1}", transform(np.eye(3), at), (shape,), movable)
