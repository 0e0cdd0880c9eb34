"""Tune the insertion of a PSM: step it, look at the answer, change P and D, step again.

One sees: the dVRK's gains, which creep; too little D, which swings; gains that a search found; and
what they ask of the motor.
"""

from trocar.descriptions import load_arm
from trocar.robot.tuning import Gains, StepBench, StepTrace, TuneSettings, tune

JOINT = "insertion"


def tries() -> dict[str, Gains]:
    """Return gains worth a look."""
    (found,) = tune("psm", TuneSettings(joints=(JOINT,))).joints
    present = found.present.gains
    return {
        "the dVRK's": present,
        "too little D": Gains(present.p, present.i, present.d / 8.0),
        "tuned": found.tuned.gains,
    }


def traces() -> dict[str, tuple[Gains, StepTrace]]:
    """Step the joint with each; all other joints are held."""
    bench = StepBench(load_arm("psm"))
    return {name: (gains, bench.step(JOINT, gains)) for name, gains in tries().items()}


def main() -> None:
    """Run the lesson."""
    found = traces()
    way = next(iter(found.values()))[1]
    print(f"{JOINT}: a step of {1e3 * (way.target - way.position[0]):.2f} mm")
    for name, (gains, trace) in found.items():
        answer = trace.response
        print(f"{name}: P {gains.p:g} N/m, D {gains.d:g} N s/m")
        print(f"  rises in {1e3 * answer.rise_time_s:6.1f} ms, overshoots {answer.overshoot:6.1%},")
        print(f"  settles in {1e3 * answer.settling_time_s:6.1f} ms,", end=" ")
        print(f"asks {answer.peak_effort_share:.0%} of the motor")


if __name__ == "__main__":
    main()
