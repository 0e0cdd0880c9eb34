"""Scripts written for the dVRK, run without ROS: their imports are made here.

`Stepped` lets simulated time pass only while the script waits; `Live` keeps to the wall clock.
"""

from trocar.scripts.run import Outcome, ScriptError, rig_for, run_script
from trocar.scripts.simulation import Flow, Live, Stepped

__all__ = ["Flow", "Live", "Outcome", "ScriptError", "Stepped", "rig_for", "run_script"]
