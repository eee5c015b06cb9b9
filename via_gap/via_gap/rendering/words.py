"""What a report says, in sentences: plain text, so that page and terminal tell the same."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

from via_sim.catalogue import EFFECTS
from via_sim.effects import place_name

from via_gap.candidates.location import MEASUREMENT_ONLY
from via_gap.logs.findings import Finding
from via_gap.rendering.numbers import number, percent
from via_gap.report.figures import Member, Trial
from via_gap.report.report import Cause, GapReport, Place, Proposal, Where

Spot = tuple[str, str, int]  # effect, site, motor
PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck"}
AT = {
    "command": "in the command path of motor {}",
    "motor": "at motor {}",
    "transmission": "in transmission {}",
    "sensor": "in the sensor of motor {}",
    "timing": "in the timing of motor {}'s channel",
}
AT_LINK = {
    "command": "in the command path",
    "sensor": "in the link's encoder",
    "timing": "in the timing of the link's channel",
    "link": "at the link",
    "environment": "from the environment",
}
AT_BOTH = {"motor": "at both motors", "transmission": "in both transmissions"}
LEVELS = {
    "full": "link, motors and torques were seen: every equation of the model can be looked at",
    "no torque": "motor angles were seen, torques were not: commands stand for them",
    "link only": "no motor angle was seen: only the simulated link can be compared",
    "encoder and command": "the link's angle and the commanded angle were seen; the drive's torque follows from both",
    "commands only": "only commands and the link were seen: only the simulated link can be compared",
}
SIGNALS = {"q": "link angle q", "theta_1": "motor 1 angle", "theta_2": "motor 2 angle", "tau": "drive torque tau"}
CLOSE = 0.2  # of a score: what comes no further behind ties with the best, or is dropped for being needless
HELPS = 0.95  # of the squared error: a cause that leaves more is said not to help
DECIDED = 2.0  # standard deviations by which a cause must be behind to be ruled out
ABOVE = 3.0  # times the sensors' floor: an error that is said to stay
FAR = 1.25  # times the ceiling: an error that a flexible model is said to close further
OFF = 1.5  # times what tuned numbers leave: filed ones are said to be off
SEVERAL = 3  # logs that are named one by one
CLOSED = 0.9  # of what can be closed: less is said to leave something


def effect_words(name: str) -> str:
    """coulomb_friction -> Coulomb friction."""
    return " ".join(PROPER.get(word, word) for word in name.split("_"))


def site_words(site: str, motor: int) -> str:
    """(motor, 1) -> at motor 1, (motor, 0) -> at both motors."""
    return AT[site].format(motor) if motor and site in AT else AT_BOTH.get(site, AT_LINK.get(site, site))


def place_words(place: Place | Cause | Member) -> str:
    """backlash in transmission 1."""
    return f"{effect_words(place.effect)} {site_words(place.site, place.motor)}"


def listed(words: Sequence[str], last: str = "and") -> str:
    """a, b and c."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} {last} {words[-1]}" if words else ""


def capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def headline(report: GapReport) -> str:
    """The verdict in one sentence."""
    verdict, gap = report.verdict, report.gap
    if verdict == "no_gap" and _off(report):
        return (
            "No effect is missing: with its own numbers moved inside their tolerance, the model explains this log down "
            "to its sensors."
        )
    if verdict == "no_gap":
        return "No gap: the model explains this log down to what its sensors and its own tolerances allow."
    if verdict == "cannot_tell":
        return f"This log cannot tell what causes the gap: {_why_not(report)}."
    if in_part(report):
        named = listed([place_words(p) for p in report.effects])
        left = f": {percent(gap.after)} of {percent(gap.before)} stay" if gap is not None else ""
        return f"{capital(named)} explain the gap in part{left}."
    if verdict == "unknown":
        return f"None of the known effects explains the gap{_best_of_none(report)}."
    read = [place_words(p) for p in report.effects if of_readings(p)]
    moved = [place_words(p) for p in report.effects if not of_readings(p)]
    shown = f"{listed(read)} {'differ' if len(read) > 1 else 'differs'} from the device file, as the readings show"
    if not moved:
        return f"{capital(shown)}; the motion itself shows no gap."
    closed = f"{percent(gap.closes)} of what can be closed" if gap is not None else ""
    besides = f"; besides, {shown}" if read else ""
    tied = [place_words(p) for p in report.equivalence_set if p not in report.effects]
    if len(moved) > 1:
        closes = f": they close {closed}" if closed else ""
        return f"{capital(listed(moved))} together explain the gap{closes}{besides}."
    if tied:
        return f"One effect explains the gap, but this log cannot tell which: {listed([*moved, *tied], 'or')}{besides}."
    closes = f": it closes {closed}" if closed else ""
    return f"{capital(moved[0])} explains the gap{closes}{besides}."


def in_part(report: GapReport) -> bool:
    """Whether several effects were found that each help, and that leave more than could be called explained."""
    return report.verdict == "unknown" and len(report.effects) > 1


def of_readings(place: Place | Cause) -> bool:
    """Whether an effect is seen in a sensor's readings and not in the motion."""
    drives = place.effect in EFFECTS and EFFECTS[place.effect].of_drive
    return place.site == "sensor" and (place.effect in MEASUREMENT_ONLY or drives)


def cautions(report: GapReport) -> tuple[str, ...]:
    """What must not be overlooked beside the verdict."""
    said, gap = [], report.gap
    if report.verdict == "no_gap" and _off(report):
        said.append("With the device file as it stands the simulator is off: use the fitted numbers, not those filed.")
    if gap is not None and report.verdict in ("effect", "two_effects") and gap.closes < CLOSED:
        said.append(f"Something else is missing as well: {percent(1.0 - gap.closes)} of what can be closed stays open.")
    tied = list(dict.fromkeys(one for one, _, _ in _tied(report))) if report.verdict != "cannot_tell" else []
    if tied:
        held = listed([place_words(p) for p in tied])
        best, wrong = ("each the best", "any may") if len(tied) > 1 else ("the best", "it may")
        said.append(f"The repair holds {held}, {best} of the tied causes: {wrong} be the wrong one.")
    elif gap is not None and report.verdict in ("effect", "two_effects") and gap.after > ABOVE * gap.floor > 0.0:
        said.append(
            f"The error that stays, {percent(gap.after)}, is {number(gap.after / gap.floor, 2)} times what the sensors "
            "explain; no model tried on this log does better."
        )
    if report.verdict == "unknown" and report.effects:
        named = listed([place_words(p) for p in report.effects])
        more = "something else is missing as well" if in_part(report) else "it is not the explanation"
        said.append(f"The repair holds {named}: it makes the simulator better, {more}.")
        if gap is not None and gap.by == "shots" and gap.after > FAR * gap.ceiling:
            said.append(
                f"Of the {percent(gap.after)} that stay a flexible model beside it leaves {percent(gap.ceiling)}."
            )
    at_bound = [n.name for n in report.nuisance if n.at_bound]
    if at_bound and report.verdict != "cannot_tell":
        said.append(f"Fitted to the end of what the device file tolerates: {listed(at_bound)}. Check this first.")
    return tuple(said)


def gap_words(report: GapReport) -> str:
    """How the gap was measured, and how large it is; empty where it was not."""
    gap = report.gap
    if gap is None:
        return ""
    how = {
        "shots": "The error of the simulated signals on data that was not fitted, relative to how much the measured "
        "ones vary, in short runs that start anew from the measured state (errors stay small in them: compare with "
        "the floor, not with 100 %)",
        "free run": "The error of the simulated signals on data that was not fitted, relative to how much the measured "
        "ones vary, in one free run from the first sample to the last",
        "equations": "The torque that the joint's equation lacks along motion that was not fitted, relative to how "
        "much the drive's torque varies",
    }[gap.by]
    found = f", {percent(gap.after)} with those and what was found" if report.effects else ""
    return (
        f"{how}: {percent(gap.before)} with the device file as it stands, {percent(gap.tuned)} with its own numbers "
        f"moved inside their tolerance{found} (95 % interval {percent(gap.interval[0])} to "
        f"{percent(gap.interval[1])}). The sensors alone leave {percent(gap.floor)}; the best that a model was seen to "
        f"reach is {percent(gap.ceiling)}."
    )


def findings(report: GapReport) -> tuple[tuple[str, str, str], ...]:
    """(severity, logs, text) of the data check; what several logs share is told once."""
    grouped: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in report.data_check:
        grouped.setdefault((finding.severity, finding.check, finding.signal), []).append(finding)
    found = []
    for (severity, _, _), group in grouped.items():
        logs = list(dict.fromkeys(each.log for each in group))
        same = len({each.text for each in group}) == 1
        told = group[0].text if same else f"{group[0].text} (the first; others alike)"
        found.append((severity, log_words(logs), told))
    return tuple(found)


def log_words(names: Sequence[str]) -> str:
    """Logs by name, or how many there are."""
    return listed(names) if len(names) <= SEVERAL else f"{len(names)} logs, {names[0]} first"


def where_words(where: Where) -> str:
    """transmission 1, both motors, link..."""
    return place_name(where.site, where.motor)


def seen_in(where: Where) -> str:
    """What shows that the gap lies there."""
    told = {"simulation": "the simulation only", "readings": "the readings themselves"}
    return told.get(where.equation, f"equation: {where.equation}")


def evidence(report: GapReport, cause: Cause) -> str:
    """What speaks for a cause."""
    if of_readings(cause):
        return f"Evidence: the readings alone; put right, {percent(cause.left)} of their squared error is left."
    together = len([p for p in report.effects if not of_readings(p)]) > 1 and any(
        (p.effect, p.site, p.motor) == (cause.effect, cause.site, cause.motor) for p in report.effects
    )
    what = "all effects named together leave" if together else "it leaves"
    return f"Evidence: on data not fitted {what} {percent(cause.left)} of the squared error that tuning leaves."


def told_apart(one: str, other: str) -> str:
    """What separates two effects by the catalogue; empty where it says nothing of the two."""
    for first, second in ((one, other), (other, one)):
        if first not in EFFECTS:
            continue
        for clause in EFFECTS[first].confused_with.split("; "):
            names, _, how = clause.partition(": ")
            if second in names.replace(" ", "").split(","):
                return how
    return ""


def equivalence_words(report: GapReport) -> tuple[str, ...]:
    """Why the causes of the set are not told apart, one sentence for each beside those named."""
    said = []
    for one, other, trial in _tied(report):
        how = told_apart(one.effect, other.effect)
        close = (
            f"on held-out data their scores differ by {number(trial.behind, 2)} ± {number(trial.behind_sd, 1)}, which "
            f"is no more than chance or errors of the device's numbers make"
            if trial is not None
            else "on held-out data both leave the same error"
        )
        ask = f" Ask for: {how}." if how else ""
        moved = "the same effect at another place" if one.effect == other.effect else "both bend this motion alike"
        said.append(f"This log cannot separate {place_words(one)} from {place_words(other)}: {close}; {moved}.{ask}")
    return tuple(said)


def _tied(report: GapReport) -> Iterator[tuple[Place, Place, Trial | None]]:
    """Of each cause in the set that is not named: which of those named it may stand for, it, and how both fared.

    It stands for the one that is missing from the best set of as many effects with it; of a single cause, for that.
    """
    if report.verdict not in ("effect", "two_effects", "cannot_tell") or not report.equivalence_set:
        return
    named = [each for each in report.effects if not of_readings(each)] or [*report.effects, *report.equivalence_set][:1]
    trials = report.figures.trials if report.figures is not None else ()
    for other in report.equivalence_set:
        if other in named or other in report.effects:
            continue
        (spot,) = _spots([other])
        sets = [(t, _spots(t.effects)) for t in trials if len(t.effects) == len(named)]
        alike = [(t, [each for each in named if not _spots([each]) & spots]) for t, spots in sets if spot in spots]
        trial, missing = min(alike, key=lambda found: (len(found[1]), found[0].behind), default=(None, named))
        yield missing[0], other, trial


@dataclass(frozen=True)
class Dismissed:
    """A cause that was fitted to the end and is not the answer; `decided`: by more than chance makes."""

    what: str
    why: str
    decided: bool


def ruled_out(report: GapReport) -> tuple[Dismissed, ...]:
    """What was fitted to the end and is not the answer, nearest first."""
    if report.figures is None or not report.figures.trials:
        tied = _spots((*report.equivalence_set, *report.effects))
        return tuple(
            Dismissed(place_words(c), f"leaves {percent(c.left)} of the squared error", True)
            for c in report.causes
            if (c.effect, c.site, c.motor) not in tied
        )
    tied = _spots(report.equivalence_set if report.verdict != "unknown" else ())
    answer, kept = _spots(report.effects), _spots(report.causes)
    size = max(1, sum(not of_readings(each) for each in report.effects))
    found = []
    for trial in report.figures.trials:
        members = _spots(trial.effects)
        if members == answer and report.verdict != "unknown":
            continue
        if len(members) == size and members <= tied and (size == 1 or trial.behind < CLOSE):
            continue
        behind = f", {number(trial.behind, 2)} ± {number(trial.behind_sd, 1)} behind the best in score"
        leaves = f"leaves {percent(trial.left)} of the squared error" if trial.left < HELPS else "does not help"
        why = f"{leaves}{behind if trial.behind > 0.0 else ''}"
        if len(members) < len(answer) and members <= answer:
            why = f"alone {why}"
        elif (
            report.verdict != "unknown"
            and members & kept == set()
            and trial.behind < CLOSE
            and _same_place(members, kept)
        ):
            why = f"does nothing that a simpler effect at the same place does not: {why}"
        elif report.verdict != "unknown" and len(members) > len(answer) > 0 and answer <= members:
            why = f"the added effect closes too little to be believed: {why}"
        decided = report.verdict == "unknown" or trial.behind > DECIDED * trial.behind_sd
        found.append(Dismissed(listed([place_words(m) for m in trial.effects]), why, decided))
    return tuple(found)


def boxes(report: GapReport) -> tuple[tuple[str, str], ...]:
    """(what, number) of the gap at a glance; what is closed only where a cause is named."""
    gap = report.gap
    if gap is None:
        return ()
    named = report.verdict in ("effect", "two_effects") and not all(map(of_readings, report.effects))
    after = "gap with the repair" if named else "gap, best attempt" if report.effects else "gap, numbers tuned"
    closed = (("closed of what can be", percent(gap.closes)),) if named else ()
    ends = (("gap as filed", percent(gap.before)), (after, percent(gap.after)), ("sensors alone", percent(gap.floor)))
    return ends + closed


def screened_words(report: GapReport) -> str:
    """What fell out before it was fitted to the end."""
    if report.figures is None or not report.figures.screened:
        return ""
    places: dict[str, list[str]] = {}
    for member in report.figures.screened:
        places.setdefault(effect_words(member.effect), []).append(site_words(member.site, member.motor))
    named = "; ".join(f"{name} ({listed(at)})" for name, at in sorted(places.items()))
    count = len(report.figures.screened)
    return f"{count} more were tried and set aside after a first fit, because they explained far less: {named}."


def next_steps(report: GapReport) -> tuple[str, ...]:
    """What to do now, most useful first."""
    said = []
    if report.proposal is not None:
        said.append(_proposed(report.proposal))
    elif equivalence_words(report):
        hows = {told_apart(one.effect, other.effect) for one, other, _ in _tied(report)} - {""}
        wish = f": {listed(sorted(hows))}" if hows else ""
        said.append(f"Record a motion that separates the tied causes{wish}; then diagnose again with both logs.")
    refused = [f for f in report.data_check if f.severity == "refuse"]
    if refused:
        said.append("Mend what the data check refuses, then record again.")
    if report.verdict == "cannot_tell" and not refused and report.not_judged:
        said.append(f"Record what is missing: {report.not_judged[0].split(':')[0]}.")
    if report.verdict == "unknown":
        said.append("Look where most of the gap lies: an effect outside the catalogue acts there.")
    if report.verdict == "no_gap" and report.nuisance:
        said.append("Put the fitted numbers into the device file where they are better known now.")
    return tuple(said)


def _proposed(proposal: Proposal) -> str:
    """The motion to record next, and where its commands are."""
    apart = listed([place_words(p) for p in proposal.separates], "from")
    shown = proposal.text or (
        f"run a motion of {number(proposal.duration)} s that separates {apart}: their predictions differ there by "
        f"{number(proposal.expected_disagreement, 2)} times the noise"
    )
    commands = (
        f"its commands are in {proposal.file}"
        if proposal.file
        else "via gap propose REPORT.json --out motion.csv writes its commands"
    )
    return f"{capital(shown)}; {commands}. Then diagnose again with both logs."


def _off(report: GapReport) -> bool:
    """Whether the device's numbers as filed leave clearly more than the fitted ones."""
    gap = report.gap
    return gap is not None and gap.before > OFF * max(gap.after, gap.ceiling)


def _why_not(report: GapReport) -> str:
    for finding in report.data_check:
        if finding.severity == "refuse":
            return f"{finding.log}: {finding.text}"
    if len(report.equivalence_set) > 1:
        return f"{len(report.equivalence_set)} causes fit it equally well"
    return report.not_judged[0].split(":")[0] if report.not_judged else "it shows too little of the joint"


def _best_of_none(report: GapReport) -> str:
    if not report.causes:
        return ""
    best = min(report.causes, key=lambda cause: cause.left)
    if best.left >= HELPS:
        return ": none of them helps on data that was not fitted"
    return f": the best, {place_words(best)}, leaves {percent(best.left)} of the squared error"


def _same_place(members: Collection[Spot], kept: Collection[Spot]) -> bool:
    return len(members) == 1 and next(iter(members))[1:] in {each[1:] for each in kept}


def _spots(places: Iterable[Place | Cause | Member]) -> set[Spot]:
    return {(place.effect, place.site, place.motor) for place in places}
