"""Sample files of a simulated PSM: a log, a rosbag, a URDF and a lab's dVRK configuration."""

from trocar.robot.samples.write import write_samples

__all__ = ["write_samples"]
