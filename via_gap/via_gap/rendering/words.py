"""The decision in sentences: headline, cautions, gap, next steps. Page and terminal print the same.

Every sentence follows from the verdict, the named effects and the tied causes of the report. No sentence depends on a
threshold of its own, so that none can contradict the verdict.
"""

from __future__ import annotations

import re

from via_gap.logs.between import LATE_TORQUES
from via_gap.rendering.evidence_words import names_causes, ties
from via_gap.rendering.names import (
    HALVES,
    QUANTITIES,
    SIGNALS,
    capital,
    listed,
    of_measurements,
    place_words,
    plain,
    where_words,
)
from via_gap.rendering.numbers import number, percent
from via_gap.report.figures import ErrorBin, ErrorFigure
from via_gap.report.report import GapReport, Proposal
from via_gap.selection.numbers import NUMBERS

ERROR = "The gap is the error of the simulated signals on held-out data, relative to the standard deviation of"
METHOD = {
    "segments": f"{ERROR} the measured ones. The simulation restarts from the measured state at every short segment, "
    "so errors stay small: compare them with the sensor noise, not with 100 %.",
    "free run": f"{ERROR} the measured ones. The simulation runs freely from the first sample to the last.",
    "inverse dynamics": "The gap is the missing torque: the torque that the measured motion of held-out data requires "
    "and the model does not provide, relative to the standard deviation of the drive's torque.",
}


def headline(report: GapReport) -> str:
    """The verdict in one sentence."""
    logs = "this log" if len(report.logs) == 1 else "these logs"
    if report.verdict == "no_gap":
        return f"No gap: with its parameters inside their tolerances, the model reproduces {logs} within sensor noise."
    if report.verdict == "cannot_tell":
        return f"The cause of the gap cannot be determined: {_reason(report)[0]}."
    if report.verdict == "unknown":
        return f"No effect of the catalogue accounts for the gap{_nearest(report)}."
    measured = [place_words(p) for p in report.effects if of_measurements(p)]
    moved = [place_words(p) for p in report.effects if not of_measurements(p)]
    differ = "differ" if len(measured) > 1 else "differs"
    shown = f"{listed(measured)} {differ} from the device file, as the measurements themselves show"
    if not moved:
        return f"{capital(shown)}; the motion itself shows no gap."
    part = f"{'most of the gap' if report.verdict == 'main_effect' else 'the gap'}{_when(report)}"
    share = f"{percent(report.explained)} of the explainable error"
    besides = f"; in addition, {shown}" if measured else ""
    if len(moved) > 1:
        return f"{capital(listed(moved))} together explain {part}: {share}{besides}."
    tied = [place_words(p) for p in report.equivalence_set if p not in report.effects]
    if tied:
        which = listed([*moved, *tied], "or")
        return f"One effect explains {part} ({share}), but {logs} cannot show which: {which}{besides}."
    return f"{capital(moved[0])} explains {part}: {share}{besides}."


def cautions(report: GapReport) -> tuple[str, ...]:
    """Reservations that belong to the headline."""
    said, gap = [], report.gap
    if report.verdict == "no_gap" and gap is not None:
        said.append(
            f"The device file as filed has an error of {percent(gap.before)}, the fitted parameters one of "
            f"{percent(gap.after)}."
        )
    if report.verdict == "cannot_tell":
        said.append(_reason(report)[1])
    if report.part is not None:
        outside = "Before" if report.part.begin > 0.0 else "Later"
        make = "this effect makes" if len(report.effects) == 1 else "these effects make"
        said.append(f"{outside}, {make} the error larger. All numbers below are about the part with the larger gap.")
    if report.verdict == "main_effect":
        said.append(remainder(report))
    if report.verdict == "unknown":
        best = f" to {percent(gap.bound)}" if gap is not None and gap.bound < gap.after else ""
        said.append(
            f"A flexible torque model reduces the error{best}: it repeats with the motion. An effect outside the "
            "catalogue acts on the joint, or several effects that could not be identified together."
        )
    if not names_causes(report) and report.verdict != "no_gap":
        said.append(largest_error(report, "error"))
    replaced = list(dict.fromkeys(tie.named for tie in ties(report)))
    if names_causes(report) and replaced:
        held = listed([place_words(place) for place in replaced])
        may = "each may" if len(replaced) > 1 else "it may"
        said.append(f"Of the tied causes, the repair contains {held}: {may} be the wrong one.")
    if report.verdict == "cannot_tell" and report.effects:
        held = listed([place_words(place) for place in report.effects])
        said.append(f"Of the tied causes, the effects file below contains {held}, for comparison only.")
    said += [f"{capital(each.text)}." for each in report.data_check if each.signal == LATE_TORQUES][:1]
    at_bound = [each.name for each in report.nuisance if each.at_bound]
    if at_bound and report.verdict != "cannot_tell":
        said.append(f"Fitted to the limit of the tolerance in the device file: {listed(at_bound)}. Check this first.")
    return tuple(each for each in said if each)


def _when(report: GapReport) -> str:
    """From when on, or until when, the effects act; empty: in the whole log."""
    if report.part is None:
        return ""
    begin, end = number(report.part.begin), number(report.part.end)
    return f" from {begin} s on" if report.part.begin > 0.0 else f" until {end} s"


def remainder(report: GapReport) -> str:
    """How large the error is that the named effects leave, and where it is largest."""
    if report.gap is None:
        return "Another effect acts as well."
    gap = report.gap
    noise = f"sensor noise alone gives {percent(gap.floor)}"
    if _achieved(report):
        said = (
            f"An error of {percent(gap.after)} remains, where {noise}. A flexible torque model, fitted to the same "
            "motion, explains no more of it."
        )
    else:
        said = (
            f"Another effect acts as well: an error of {percent(gap.after)} remains, where {percent(gap.bound)} is "
            f"achievable and {noise}."
        )
    return f"{said}{_transfer(report)} {largest_error(report, 'remaining error')}".rstrip()


def _achieved(report: GapReport) -> bool:
    """Whether a flexible torque model leaves as much of the error as the named effects."""
    gap = report.gap
    return report.explained >= NUMBERS.complete and (gap is None or gap.bound >= NUMBERS.complete * gap.after)


def largest_error(report: GapReport, name: str) -> str:
    """A sentence about where the error of this `name` is largest; empty if no figure shows it."""
    found = largest_remainder(report)
    if found is None or report.gap is None:
        return ""
    figure, worst = found
    over = f"{QUANTITIES.get(figure.by, figure.by)} {number(worst.low)} to {number(worst.high)} {figure.unit}"
    signal = f" of the {SIGNALS.get(figure.signal, figure.signal)}" if len(report.gap.signals) > 1 else ""
    return f"The {name}{signal} is largest at {over}."


def _transfer(report: GapReport) -> str:
    """A sentence about the halves of the motion between which the repair transfers worst; empty without any."""
    if not report.transfer:
        return ""
    quantity = max(report.transfer, key=lambda each: report.transfer[each])
    one, other = HALVES.get(quantity, (f"small {quantity}", f"large {quantity}"))
    return (
        f" Fitted to {one} and compared on {other}, and the reverse, the repair leaves "
        f"{percent(report.transfer[quantity])} of the squared error{_sizes(report)}."
    )


def _sizes(report: GapReport) -> str:
    """The first parameter of the main effect in both of these fits; empty if only combinations are determined."""
    if not report.halves:
        return ""
    name, (low, high) = next(iter(report.halves.items()))
    (cause,) = (each for each in report.causes if each.place == report.effects[0])
    if cause.combinations:
        return ""
    unit = cause.parameters[name].unit
    shown = "" if unit == "-" else f" {unit}"
    return f"; its {plain(name)} is {number(low)}{shown} in the first fit and {number(high)}{shown} in the second"


def largest_remainder(report: GapReport) -> tuple[ErrorFigure, ErrorBin] | None:
    """The range of a quantity with the largest ratio of the error after the repair to its mean."""
    best, found = 0.0, None
    for figure in report.figures.errors if report.figures is not None else ():
        mean = sum(each.after**2 for each in figure.bins) / max(len(figure.bins), 1)
        for each in figure.bins:
            if mean > 0.0 and each.after**2 / mean > best:
                best, found = each.after**2 / mean, (figure, each)
    return found


def gap_words(report: GapReport) -> str:
    """How the gap is measured, and how large it is; empty where it was not measured."""
    gap = report.gap
    if gap is None:
        return ""
    after = f", and {percent(gap.after)} with the effects added as well" if report.effects else ""
    return (
        f"{METHOD[gap.by]} It is {percent(gap.before)} with the device file as filed, {percent(gap.tuned)} with its "
        f"parameters fitted inside their tolerances{after} (95 % interval {percent(gap.interval[0])} to "
        f"{percent(gap.interval[1])}). Sensor noise alone gives {percent(gap.floor)}; the lowest error that a flexible "
        f"torque model achieves is {percent(gap.bound)}."
    )


def boxes(report: GapReport) -> tuple[tuple[str, str], ...]:
    """(what, number) of the gap; the fraction explained only where causes are named."""
    gap = report.gap
    if gap is None:
        return ()
    moved = [each for each in report.effects if not of_measurements(each)]
    after = "gap, repaired" if names_causes(report) and moved else "gap, parameters fitted"
    if report.effects and not names_causes(report):
        after = "gap, best of the tied causes"
    found = [("gap, as filed", percent(gap.before)), (after, percent(gap.after)), ("sensor noise", percent(gap.floor))]
    if names_causes(report) and moved:
        found.append(("explained", percent(report.explained)))
    return tuple(found)


def repair_words(report: GapReport) -> str:
    """What the effects file of a report contains."""
    if names_causes(report):
        return "The repair as an effects file, which the simulator loads"
    if report.effects:
        return "One of the tied causes as an effects file, for comparison only"
    return "The fitted device parameters as an effects file, which the simulator loads"


def next_steps(report: GapReport) -> tuple[str, ...]:
    """What to do now, most useful first."""
    said = []
    refused = [each for each in report.data_check if each.severity == "refuse"]
    if ties(report) and report.proposal is not None:
        said.append(_proposed(report.proposal))
    elif ties(report):
        hows = sorted({tie.separated_by for tie in ties(report)} - {""})
        wish = f" ({listed(hows)})" if hows else ""
        said.append(f"Record a motion that separates the tied causes{wish}, then diagnose again with both logs.")
    elif report.verdict == "cannot_tell" and refused:
        said.append("Correct what the data check reports, then record again.")
    elif report.verdict == "cannot_tell":
        said.append("Record again with larger and more varied motion, and repeat the motion; then diagnose all logs.")
    if names_causes(report):
        said.append("Load the repair below into the simulator, and compare it with a new log.")
    if report.part is not None:
        said.append(f"Find out what changed at {number(report.part.begin or report.part.end)} s.")
    if report.verdict == "main_effect" and _achieved(report):
        said.append(
            "Record the same motion twice: if the remaining error is the same in both, an effect outside the catalogue "
            "causes it; if not, disturbances do."
        )
    elif report.verdict == "main_effect":
        said.append("Then look for the effect that causes the remaining error.")
    if report.verdict == "unknown":
        at = f", first at {where_words(report.where[0])}" if report.where else ""
        said.append(f"Look for an effect outside the catalogue{at}.")
    if report.verdict == "no_gap" and report.nuisance:
        said.append("Simulate with the fitted parameters below, or enter the well-determined ones in the device file.")
    return tuple(said)


def _proposed(proposal: Proposal) -> str:
    """The motion to record next, and where its commands are."""
    apart = listed([place_words(p) for p in proposal.separates], "from")
    shown = proposal.text or (
        f"run a motion of {number(proposal.duration)} s that separates {apart}: their predictions differ there by "
        f"{number(proposal.expected_disagreement, 2)} times the noise"
    )
    if not proposal.separable:
        return f"{capital(plain(shown))}."
    commands = (
        f"its commands are in {proposal.file}"
        if proposal.file
        else "via gap propose REPORT.json --out motion.csv writes its commands"
    )
    return f"{capital(plain(shown))}; {commands}. Then diagnose again with both logs."


def _reason(report: GapReport) -> tuple[str, str]:
    """Why nothing is named: a clause for the headline, and the sentences that follow it."""
    clause, mark, rest = re.match(r"(.*?)(?:(; |\. )(.*))?$", plain(_whole_reason(report)), re.DOTALL).groups("")  # type: ignore[union-attr]
    return clause.rstrip("."), f"{capital(rest).rstrip('.')}." if mark else ""


def _whole_reason(report: GapReport) -> str:
    if report.reason:
        return report.reason
    for finding in report.data_check:
        if finding.severity == "refuse":
            return f"{finding.log}: {finding.text}"
    if len(report.equivalence_set) > 1:
        return f"{len(report.equivalence_set)} causes explain these data equally well"
    return report.not_evaluated[0].split(":")[0] if report.not_evaluated else "the data show too little of the joint"


def _nearest(report: GapReport) -> str:
    """The first-ranked cause, where it lowers the error at all."""
    if not report.causes or report.causes[0].left >= 1.0:
        return ""
    first = report.causes[0]
    return f"; the nearest, {place_words(first)}, leaves {percent(first.left)} of the squared error"
