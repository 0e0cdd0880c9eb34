"""How a joint answers a step, and gains that answer better."""

from trocar.apps.tuning.response import StepResponse, step_response
from trocar.apps.tuning.step_bench import StepBench, StepTrace
from trocar.apps.tuning.tune import JointTuning, Tried, TuneSettings, TuningReport, tune
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
