"""Step responses of joints, and the search for gains that respond better."""

from trocar.apps.tuning.gains import JointTuning, Tried, TuneSettings, TuningReport, tune
from trocar.apps.tuning.steps import StepBench, StepResponse, StepTrace, step_response
from trocar.descriptions.records import Gains

__all__ = [
    "Gains",
    "JointTuning",
    "StepBench",
    "StepResponse",
    "StepTrace",
    "Tried",
    "TuneSettings",
    "TuningReport",
    "step_response",
    "tune",
]
