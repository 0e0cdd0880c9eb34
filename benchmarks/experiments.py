"""The experiments of `python -m benchmarks`."""

from __future__ import annotations

from collections.abc import Callable, Collection

from trocar.robot.experiments import Experiment
from trocar.robot.verification.figures import Figure

#: Grounds and cameras of the images in which needles are tracked.
STYLES = ("plain", "surgical", "light")
PRESETS = ("hd_1280x720", "dvrk_sd_640x480")

EXPERIMENTS = (
    Experiment("startup", "time to the help and to the first motion", "benchmarks.startup:startup"),
    Experiment(
        "recording",
        "cost of recording the full cart in motion",
        "benchmarks.recording:recording",
        {"duration": "duration_s", "passes": "passes"},
        extra="record",
    ),
    Experiment(
        "interface",
        "readings and commands as a client in another process sees them",
        "benchmarks.interface:interface",
        {"transport": "transports", "duration": "duration_s"},
        {"transports": ("websocket",), "duration_s": 10.0},
    ),
    Experiment(
        "scope",
        "pictures of the endoscope a second, beside MuJoCo's own renderer and in real time",
        "benchmarks.scope:scope",
        {"duration": "duration_s", "live": "live_s", "no_browser": "onlooker"},
        extra="scope",
    ),
    Experiment(
        "drawing",
        "frames that a browser without a graphics card draws of the moving cart, at each level",
        "benchmarks.drawing:drawing",
    ),
    Experiment(
        "viewer",
        "the page of the cart with two viewers, looking back, and a dragged tip (2 minutes)",
        "benchmarks.viewer:viewer",
    ),
    Experiment(
        "laws", "momentum, friction, soft pads and elastic bands of props", "benchmarks.laws:laws"
    ),
    Experiment(
        "carts",
        "real-time factor of the Si's patient cart against the Classic's",
        "benchmarks.carts:carts",
        {"passes": "passes"},
    ),
    Experiment(
        "grip",
        "slip of a held needle, and loads at which a jaw lets go",
        "benchmarks.grip:grip",
    ),
    Experiment(
        "suturing",
        "stitches through soft tissue (50 episodes: 30 minutes on one core)",
        "benchmarks.suturing:suturing",
        {"episodes": "episodes", "case": "only", "keep": "kept"},
        {"episodes": 50},
    ),
    Experiment(
        "tasks",
        "success, time, forces and speed of the scripted policies of all scenes, or of another",
        "benchmarks.tasks:tasks",
        {
            "scene": "scenes",
            "episodes": "episodes",
            "keep": "file",
            "policy": "policy",
            "trust": "trust",
        },
        {"scenes": (), "episodes": 50},
    ),
    Experiment(
        "learning",
        "needle-reach by SAC with HER, three trainings (5 minutes on one core)",
        "benchmarks.learning:reach",
        {"short": "short"},
        part="reach",
        extra="learn",
    ),
    Experiment(
        "learning",
        "needle-pick by behaviour cloning (2 minutes)",
        "benchmarks.learning:pick",
        {"short": "short"},
        part="pick",
        extra="learn",
    ),
    Experiment(
        "learning",
        "peg-transfer by behaviour cloning (3 minutes)",
        "benchmarks.learning:peg",
        {"short": "short"},
        part="peg",
        extra="learn",
    ),
    Experiment(
        "learning",
        "bi-peg-transfer by behaviour cloning (6 minutes)",
        "benchmarks.learning:two_arms",
        {"short": "short"},
        part="two-arms",
        extra="learn",
    ),
    Experiment(
        "learning",
        "one environment: what a step of 20 ms costs beside its physics",
        "benchmarks.learning:single",
        part="single",
    ),
    Experiment(
        "learning",
        "batches of scenes: speed, parity, resets, images",
        "benchmarks.learning:batch",
        {"short": "short"},
        part="batch",
    ),
    Experiment(
        "learning",
        "scenes on a GPU (10 minutes; without one: not measured)",
        "benchmarks.learning:gpu",
        part="gpu",
        extra="gpu",
    ),
    Experiment(
        "learning",
        "policies in worlds that they were not trained in (an hour)",
        "benchmarks.learning_transfer:transfer",
        {"short": "short"},
        part="transfer",
        extra="learn",
    ),
    Experiment(
        "learning",
        "episodes in processes and on a local cluster (3 minutes; Ray by the extra cluster)",
        "benchmarks.learning_cluster:cluster",
        {"short": "short"},
        part="cluster",
    ),
    Experiment(
        "random-actions",
        "divergence, flights and depth of contacts under random actions",
        "benchmarks.random_actions:random_actions",
        {"scene": "scenes", "episodes": "episodes", "duration": "duration_s"},
    ),
    Experiment(
        "dynamics",
        "efforts predicted along recordings of real arms",
        "benchmarks.dynamics:dynamics",
        {"recordings": "folder"},
        extra="identify",
    ),
    Experiment(
        "drives",
        "cost and drift of identified dynamics in the simulation",
        "benchmarks.drives:drives",
        {"recordings": "recordings"},
        extra="identify",
    ),
    Experiment(
        "si",
        "errors at rest of an Si arm with compensation and observer on and off",
        "benchmarks.si:controller",
    ),
    Experiment(
        "si-identification",
        "parameters identified from simulated arms of an Si against the truth",
        "benchmarks.si_round_trip:si_round_trip",
        extra="identify",
    ),
    Experiment(
        "errors",
        "distance of tips from the poses that robots report",
        "benchmarks.errors:errors",
    ),
    Experiment(
        "vision",
        "calibrations of the endoscope from views of a board",
        "benchmarks.vision:hand_eye",
        {"seeds": "seeds"},
        {"seeds": 20},
        part="hand-eye",
    ),
    Experiment(
        "vision",
        "an ECM that centres an object (10 s a seed)",
        "benchmarks.servoing:servoing",
        {"seeds": "seeds"},
        {"seeds": 20},
        part="servoing",
    ),
    Experiment(
        "vision",
        "a needle that is tracked in rendered images (40 s a seed)",
        "benchmarks.needle_tracking:needle_tracking",
        {
            "seeds": "seeds",
            "workers": "workers",
            "style": "styles",
            "preset": "presets",
            "keep": "file",
        },
        {"seeds": 20, "workers": 1, "styles": STYLES, "presets": PRESETS},
        part="needle",
        extra="scope",
    ),
    Experiment(
        "vision",
        "needles in jaws alone, for a second",
        "benchmarks.experiments:held",
        {"seeds": "seeds", "first": "first", "style": "styles", "preset": "presets"},
        part="held",
        usual=False,
        extra="scope",
    ),
    Experiment(
        "vision",
        "tips of instruments in rendered images",
        "benchmarks.tips:tips",
        {"seeds": "seeds"},
        {"seeds": 20},
        part="tips",
        extra="scope",
    ),
    Experiment(
        "soak",
        "hours of the cart in motion (7 minutes each on one core)",
        "benchmarks.soak:soak_figures",
        {"duration": "duration_s", "output": "output"},
    ),
    Experiment(
        "assistance",
        "error and time of a modelled operator with and without virtual fixtures",
        "benchmarks.assistance:assistance_figures",
        {"seeds": "seeds", "output": "output"},
    ),
    Experiment(
        "bilateral",
        "force feedback against walls with delays: force, error, energy (10 minutes on one core)",
        "benchmarks.bilateral:bilateral",
        {"duration": "duration_s"},
        {"duration_s": 60.0},
    ),
    Experiment(
        "knot",
        "how far two arms get with the first throw of a knot (2 minutes)",
        "benchmarks.knot:knot",
    ),
)


def held(
    watch: Callable[[str], None],
    seeds: int = 20,
    first: int = 0,
    styles: Collection[str] = STYLES,
    presets: Collection[str] = PRESETS,
) -> list[Figure]:
    """Track needles in jaws with `seeds` seeds from `first` on."""
    from benchmarks import needle_tracking
    from benchmarks.needle_stage import Style

    chosen: list[Style] = [style for style in needle_tracking.STYLES if {style} & {*styles}]
    return needle_tracking.held(range(first, first + seeds), chosen, presets, watch)
