"""Fixtures for tests of standalone MJCF: every arm and rig, and MuJoCo's warnings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import mujoco
import pytest

from trocar.descriptions import load_arm, load_rig, names
from trocar.descriptions.records import RigDescription
from trocar.descriptions.rigs import lone_arm_rig
from trocar.formats.meshes import obj
from trocar.formats.mjcf import POSITION, Variant, mjcf_document

#: The Si arms are serial chains without masses (their [[missing]] says so).
ARMS = names("arms")
RIGS = tuple(f"{name} rig" for name in names("rigs"))


@cache
def find(name: str) -> RigDescription:
    """Return a lone arm, or a rig where the name says so."""
    if name.endswith(" rig"):
        return replace(load_rig(name.removesuffix(" rig")), name=name.replace(" ", "_"))
    return replace(lone_arm_rig(load_arm(name)), name=name)


def written(rig: RigDescription, variant: Variant = POSITION) -> tuple[str, dict[str, bytes]]:
    """Return the text of a rig's file, and its meshes by their paths."""
    text, meshes = mjcf_document(rig, variant)
    return text.decode(), {f"assets/{name}.obj": obj(mesh) for name, mesh in meshes.items()}


def compiled(rig: RigDescription, variant: Variant = POSITION) -> mujoco.MjModel:
    """Return a rig's file as MuJoCo has it."""
    return mujoco.MjModel.from_xml_string(*written(rig, variant))


@cache
def model_of(name: str, variant: Variant = POSITION) -> tuple[mujoco.MjModel, list[str]]:
    """Return an arm's or a rig's compiled file, to be read only, and what MuJoCo warned of."""
    warnings: list[str] = []
    mujoco.set_mju_user_warning(warnings.append)
    try:
        return compiled(find(name), variant), warnings
    finally:
        mujoco.set_mju_user_warning(None)


@pytest.fixture(autouse=True)
def lxml() -> None:
    pytest.importorskip("lxml", reason="exports need the extra 'export'")


@pytest.fixture
def complaints() -> Iterator[list[str]]:
    """Return MuJoCo's warnings since the test began."""
    warnings: list[str] = []
    mujoco.set_mju_user_warning(warnings.append)
    yield warnings
    mujoco.set_mju_user_warning(None)
