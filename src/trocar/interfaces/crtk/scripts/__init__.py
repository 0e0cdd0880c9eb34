"""Scripts written for the dVRK, run without ROS: what they import is made here.

    script -> crtk.ral -> Node -> Bus -> Core -> the loop of a World

`Stepped` lets simulated time pass only while the script waits; `Live` keeps to the wall clock.
"""

from trocar.interfaces.crtk.scripts.flow import Flow
from trocar.interfaces.crtk.scripts.live import Live
from trocar.interfaces.crtk.scripts.rigs import rig_for
from trocar.interfaces.crtk.scripts.run import Outcome, ScriptError, run_script
from trocar.interfaces.crtk.scripts.stepped import Stepped

__all__ = ["Flow", "Live", "Outcome", "ScriptError", "Stepped", "rig_for", "run_script"]
