"""A lab's own dVRK configuration as a rig (docs/your-lab.md)."""

from trocar.robot.dvrk_config.rig import Imported, Options, import_dvrk

__all__ = ["Imported", "Options", "import_dvrk"]
