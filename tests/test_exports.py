"""What a package exports is exactly what its `__init__` names, no more and no less."""

from __future__ import annotations

import importlib
import types
from pathlib import Path

SRC = Path(__file__).parents[1] / "src" / "trocar"
PACKAGES = sorted(
    ".".join(["trocar", *path.parent.relative_to(SRC).parts]) for path in SRC.rglob("__init__.py")
)


def public_names(module: types.ModuleType) -> set[str]:
    """Every name a reader of the module could use, modules and its own future imports aside."""
    return {
        name
        for name, value in vars(module).items()
        if not name.startswith("_")
        and not isinstance(value, types.ModuleType)
        and name not in ("annotations", "TYPE_CHECKING")
    }


def test_a_package_exports_exactly_what_it_names() -> None:
    for name in PACKAGES:
        module = importlib.import_module(name)
        exported = set(getattr(module, "__all__", ())) - {"__version__"}
        if name == "trocar":  # the front door opens on first use
            assert exported == {
                *("Batch", "Endoscope", "World", "build", "load_arm", "load_rig"),
                *("load_scene", "make", "record", "show"),
            }
            assert all(hasattr(module, each) for each in exported)
            assert public_names(module) - exported == {"Any", "import_module"}
        else:
            assert exported == public_names(module), name


def test_a_name_that_leaks_is_seen() -> None:
    module = types.ModuleType("leaky")
    module.__dict__.update(kept=1, leaked=2, _private=3, submodule=types)
    assert public_names(module) == {"kept", "leaked"}
