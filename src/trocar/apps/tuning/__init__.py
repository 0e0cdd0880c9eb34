"""Step responses of joints, and the search for gains that respond better."""

from trocar.apps.tuning.gains import GainTrial, JointTuning, TuneSettings, TuningReport, tune
from trocar.apps.tuning.steps import StepBench, StepResponse, StepTrace, step_response
from trocar.descriptions.records import Gains

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
