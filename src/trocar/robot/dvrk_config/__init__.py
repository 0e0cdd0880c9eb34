"""A lab's own dVRK configuration as a rig (docs/your-lab.md)."""

from trocar.robot.dvrk_config.rig import ImportedRig, RigImportOptions, import_dvrk

__all__ = ["ImportedRig", "RigImportOptions", "import_dvrk"]
