"""A lab's own dVRK configuration as a rig (docs/your-lab.md)."""

from trocar.apps.labs.bring import Brought, LabOrder, import_dvrk

__all__ = ["Brought", "LabOrder", "import_dvrk"]
