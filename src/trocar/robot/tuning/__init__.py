"""Step responses of joints, and the search for gains that respond better."""

from trocar.descriptions.records import Gains
from trocar.robot.tuning.gains import GainTrial, JointTuning, TuneSettings, TuningReport, tune
from trocar.robot.tuning.steps import StepBench, StepResponse, StepTrace, step_response

__all__ = [
    "GainTrial",
    "Gains",
    "JointTuning",
    "StepBench",
    "StepResponse",
    "StepTrace",
    "TuneSettings",
    "TuningReport",
    "step_response",
    "tune",
]
