"""One page of what was verified: tables, plots, sources, and how to measure it again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.metadata import version
from itertools import groupby
from pathlib import Path

from trocar import __version__
from trocar.apps import pages
from trocar.apps.drawing import svg
from trocar.apps.pages import Cell
from trocar.apps.verification import draw
from trocar.apps.verification.closure import Fold
from trocar.apps.verification.figure import Figure, Part
from trocar.apps.verification.paper import TABLE7
from trocar.apps.verification.rcm import TOLD as RUNS
from trocar.apps.verification.rcm import Cloud
from trocar.apps.verification.tracking import TOLD as GAINS
from trocar.apps.verification.verify import Verification

VERDICTS = {
    None: Cell('<span class="quiet">stated</span>'),
    True: Cell('<span class="good">met</span>'),
    False: Cell('<span class="bad">MISSED</span>'),
}
PAPER = (
    "An Approach to Modeling Closed-Loop Kinematic Chain Mechanisms, Applied to Simulations of the"
    " da Vinci Surgical System"
)


def check_report(folder: str | Path) -> Path:
    """Return where a report goes, before anything is measured for it.

    Raises:
        InputError: the folder is none
        MissingExtraError: matplotlib is not installed
    """
    return pages.page_in(folder, draw.PURPOSE)


def write_report(folder: str | Path, found: Verification) -> str:
    """Write a page with everything that was verified, and return its path.

    Args:
        folder: where index.html goes; is made when it is not there
        found: what to tell

    Raises:
        InputError: it cannot be written
        MissingExtraError: matplotlib is not installed
    """
    target = check_report(folder)
    page = pages.document("Verification of the simulation", _body(found))
    pages.write(target, page)
    return str(target)


def _body(found: Verification) -> str:
    sections = [_section([*parts]) for _, parts in groupby(found.parts, key=lambda part: part.name)]
    return "".join([*_head(found), *sections])


def _head(found: Verification) -> Iterator[str]:
    within = found.judged - len(found.missed)
    kind = "bad" if found.missed else "good"
    arms = ", ".join(dict.fromkeys(part.arm for part in found.parts if part.arm))
    yield f"<h1>Verification of the simulation: {pages.text(arms or 'speed')}</h1>"
    yield (
        f'<p><span class="{kind}">{within} of {found.judged} figures are within tolerance.</span>'
        " Each experiment is the closed-loop paper's, repeated on the simulation; its figures stand"
        " beside ours.</p>"
    )
    if found.missed:
        rows = "".join(f"<li>{pages.text(f.name)}</li>" for f in found.missed)
        yield f"<p>Out of tolerance:</p><ul>{rows}</ul>"
    links = ", ".join(
        f'<a href="#{part.name}">{pages.text(_head_of(part))}</a>'
        for part in {part.name: part for part in found.parts}.values()
    )
    yield f"<p>{links}</p>"
    yield (
        f'<p class="quiet">trocar {__version__}, MuJoCo {version("mujoco")}. The paper: '
        f"&ldquo;{PAPER}&rdquo;. Stated: told without a tolerance.</p>"
    )


def _head_of(part: Part) -> str:
    return part.title.partition(":")[0]


def _section(parts: list[Part]) -> str:
    """Return one experiment, of every arm."""
    body = [f'<h2 id="{parts[0].name}">{pages.text(parts[0].title)}</h2>']
    for part in parts:
        if part.arm and part.figures:
            own = ", with its calibration" if "--calibration" in part.command else ""
            body.append(f"<h3>{pages.text(part.arm + own)}</h3>")
        notes = part.notes if part.figures else [f"{part.arm}: {note}" for note in part.notes]
        body += [f"<p>{pages.text(note)}</p>" for note in notes]
        if part.figures:
            body += [*_pictures(part), *_numbers(part)]
            body.append(f"<p>Measure again: <code>{pages.text(part.command)}</code></p>")
    return "".join(body)


def _numbers(part: Part) -> Iterator[str]:
    """Return the table of a part, and under it where its numbers are from."""
    sources = list(dict.fromkeys(f.source for f in part.figures if f.source))
    letters = {source: chr(ord("a") + i) for i, source in enumerate(sources)}
    gazebo = any(f.paper_simulation is not None for f in part.figures)
    paper = any(f.paper is not None for f in part.figures) and part.name != "rcm"
    head = ["figure", "ours", *(["paper, hardware"] if paper else []),
            *(["paper, simulation"] if gazebo else []), "unit", "allowed", "",
            "source"]  # fmt: skip

    def row(figure: Figure) -> Sequence[str]:
        return [
            figure.name,
            figure.told(figure.value),
            *([figure.told(figure.paper)] if paper else []),
            *([figure.told(figure.paper_simulation)] if gazebo else []),
            figure.people_unit,
            figure.allowed,
            VERDICTS[figure.met],
            letters.get(figure.source, ""),
        ]

    if part.name == "rcm":
        yield _table7(part)
    shown = [f for f in part.figures if not (part.name == "rcm" and f.name[-1] in "XYZ")]
    yield pages.table(head, [row(figure) for figure in shown])
    told = "; ".join(f"<b>{letters[s]}</b> {pages.text(s)}" for s in sources)
    yield f'<p class="quiet">Sources: {told}.</p>'


def _table7(part: Part) -> str:
    """Return Table 7 as the paper has it, with our rows."""
    clouds: Sequence[Cloud] = part.data
    kind = clouds[0].kind
    compared = any(f.paper is not None for f in part.figures)
    rows: list[list[str]] = []
    if compared:
        for label, row in zip(("hardware", "simulation (Gazebo)"), TABLE7[kind], strict=True):
            values = (*row.position, *row.rms)
            rows.append([f"paper, {label}", *(f"{1e3 * v:.2f}" for v in values)])
    for cloud in clouds:
        position = [f"{round(1e3 * v, 3) + 0.0:.3f}" for v in cloud.centre]
        rms = [f"{1e3 * v:.5f}" for v in cloud.rms]
        rows.append([f"trocar, {RUNS[cloud.drive]}", *position, *rms])
    head = ["", "X [mm]", "Y [mm]", "Z [mm]", "RMS X [mm]", "RMS Y [mm]", "RMS Z [mm]"]
    return pages.table(head, rows)


def _pictures(part: Part) -> Iterator[str]:
    """Return the plots of a part with their captions."""
    if isinstance(part.data, Fold):
        yield pages.picture(svg(draw.loops(part.data)), LOOPS)
    elif part.name == "rcm":
        compared = any(f.paper is not None for f in part.figures)
        drawn = svg(draw.figure9(part.data[0].kind, part.data, compared))
        yield pages.picture(drawn, FIGURE9 if compared else FIGURE9_ALONE)
    elif part.name == "axes" and any(f.paper is not None for f in part.figures):
        yield pages.picture(svg(draw.table6(part)), TABLE6)
    elif part.name == "tracking":
        for track in part.data:
            gains = "; ".join(
                f"{joint} {p:g}, {i:g}, {d:g}"
                for joint, (p, i, d) in zip(track.joints, track.gains, strict=True)
            )
            caption = f"With {GAINS[track.model]} (P, I, D): {gains}."
            yield pages.picture(svg(draw.figure10(track)), caption)
    elif part.name == "realtime":
        yield pages.picture(svg(draw.table9(part)), "The scale is logarithmic.")


LOOPS = (
    "The sine of the angle at which the passive links of each loop stand. Where it is zero the loop"
    " is flat and could go on by the wrong branch; the range keeps clear of that on both sides."
)
FIGURE9 = (
    "Figure 9. Above: where the remote centre is, from three sides, the paper's hardware and"
    " simulation with the RMS of their clouds as bars, ours with its cloud, which is smaller than"
    " its mark. Below: our cloud alone, with servos, on a scale of its own: each dot is the remote"
    " centre as the link has it at one yaw and pitch."
)
FIGURE9_ALONE = "The cloud of Figure 9: each dot is the remote centre at one yaw and pitch."
TABLE6 = (
    "How far the description's distances are from what the paper measured on its hardware; the band"
    " is what is allowed."
)
