"""Evidence for and against causes in sentences: held-out error, tied and rejected causes, findings about the data."""

from __future__ import annotations

from dataclasses import dataclass

from via_sim.catalogue import EFFECTS

from via_gap.logs.findings import Finding
from via_gap.rendering.names import (
    effect_words,
    listed,
    log_words,
    of_measurements,
    place_words,
    plain,
    site_words,
    spot_of,
)
from via_gap.rendering.numbers import number, percent, raised, with_sd
from via_gap.report.figures import Trial
from via_gap.report.report import Cause, EffectLocation, GapReport


def names_causes(report: GapReport) -> bool:
    """Whether the decision names causes."""
    return report.verdict in ("effect", "several_effects", "main_effect")


def values_words(cause: Cause) -> tuple[str, ...]:
    """Every parameter with its standard deviation, harmonic by harmonic, then combinations that are better known.

    Beside such combinations, what may as well be zero or twice as large has no number.
    """
    shown = {name: f"{name} {with_sd(v.value, v.sd, v.unit)}" for name, v in cause.parameters.items()}
    for name in cause.parameters:
        kind, _, count = name.partition("_")
        harmonic = [f"{part}_{count}" if count else part for part in ("order", "amplitude", "phase")]
        if kind == "order" and shown.keys() >= set(harmonic):
            order, amplitude, phase = (with_sd(v.value, v.sd, v.unit) for v in map(cause.parameters.get, harmonic) if v)
            first = order.removesuffix(" 1/rev")
            shown[name] = f"order {first}: amplitude {amplitude}, phase {phase}"
            del shown[harmonic[1]], shown[harmonic[2]]
    combined = {raised(c.expression).replace("*", "·"): c for c in cause.combinations}
    known = {name: c for name, c in combined.items() if c.sd < abs(c.value)}
    unknown = [name for name, v in cause.parameters.items() if known and 0.0 < abs(v.value) <= v.sd]
    said = [text for name, text in shown.items() if name not in unknown]
    said += [f"{name} {with_sd(c.value, c.sd, c.unit)}" for name, c in known.items()]
    return (*said, *([f"{listed(unknown)} not determined separately"] if unknown else []))


def evidence(report: GapReport, cause: Cause) -> str:
    """Error that the model with a cause leaves."""
    if of_measurements(cause):
        return f"Evidence: the sensor's measurements; corrected, they keep {percent(cause.left)} of the squared error."
    modelled = {spot_of(p) for p in report.effects if not of_measurements(p)}
    together = len(modelled) > 1 and spot_of(cause) in modelled
    model = "the model with all named effects" if together else "the model with this effect"
    left = f"Held-out data: {model} leaves {percent(cause.left)} of the squared error of the model without effects"
    return f"{left}." if cause.without is None else f"{left}; without this effect, {percent(cause.without)}."


def separation(one: str, other: str) -> str:
    """What separates two effects according to the catalogue; empty where it states nothing about the pair."""
    for first, second in ((one, other), (other, one)):
        if first not in EFFECTS:
            continue
        for clause in EFFECTS[first].confused_with.split("; "):
            names, _, how = clause.partition(": ")
            if second in names.replace(" ", "").split(","):
                return how
    return ""


@dataclass(frozen=True)
class Tie:
    """A cause of the equivalence set that is not named, and the named one that it could replace.

    Where nothing is named, the causes of the best tied model stand for the named ones.
    """

    named: EffectLocation
    other: EffectLocation
    trial: Trial | None  # the evaluation of the model in which it does, where there is one

    @property
    def separated_by(self) -> str:
        return separation(self.named.effect, self.other.effect)


def ties(report: GapReport) -> tuple[Tie, ...]:
    """One for each cause of the equivalence set that is not named.

    It replaces the named cause that is missing in the best model of as many effects that contains it.
    """
    if not report.equivalence_set or report.verdict in ("unknown", "no_gap"):
        return ()
    modelled = [each for each in report.effects if not of_measurements(each)]
    trials = report.figures.trials if report.figures is not None else ()
    sets = [(trial, {spot_of(member) for member in trial.effects}) for trial in trials]
    tied = {spot_of(each): each for each in report.equivalence_set}
    size = round(sum(each.share for each in report.causes if not of_measurements(each)))  # of the tied models
    best = next((spots for _, spots in sets if len(spots) == size and spots <= tied.keys()), set())
    named = modelled or [tied[each] for each in tied if each in best] or [*report.effects, *report.equivalence_set][:1]
    found = []
    for other in report.equivalence_set:
        if other in named or other in report.effects:
            continue
        models = [
            (trial, [each for each in named if spot_of(each) not in spots])
            for trial, spots in sets
            if len(spots) == len(named) and spot_of(other) in spots
        ]
        if models:
            trial, missing = min(models, key=lambda each: (len(each[1]), each[0].behind))
            found.append(Tie((missing or named)[0], other, trial))
        else:
            found.append(Tie(named[0], other, None))
    return tuple(found)


def tie_words(report: GapReport) -> tuple[str, ...]:
    """Why each tied cause cannot be separated from a named one, and which motion would separate them."""
    said = []
    for tie in ties(report):
        close = (
            f": their held-out scores differ by {number(tie.trial.behind, 2)} ± {number(tie.trial.behind_sd, 1)}"
            if tie.trial is not None
            else ": they leave the same held-out error"
        )
        how = f" They differ in this: {tie.separated_by}." if tie.separated_by else ""
        said.append(f"These data cannot separate {place_words(tie.named)} from {place_words(tie.other)}{close}.{how}")
    return tuple(said)


def conformal_words(report: GapReport) -> str:
    """The set of causes with a guaranteed coverage; empty where none is known."""
    if not report.conformal_set:
        return ""
    causes = listed([place_words(each) for each in report.conformal_set], "or")
    return (
        f"Conformal set: {causes}. In 95 % of cases like those of the calibration, such a set contains the true cause."
    )


@dataclass(frozen=True)
class Rejected:
    """Effects that were fitted to convergence and are not in the answer, with their evaluation."""

    what: str
    left: str
    behind: str


def rejected(report: GapReport) -> tuple[Rejected, ...]:
    """What was fitted to convergence and is neither the answer nor tied with it, best first."""
    answer = {spot_of(each) for each in report.effects if not of_measurements(each)}
    tied = {spot_of(each) for each in (*report.equivalence_set, *report.effects)}
    if report.figures is None or not report.figures.trials:
        return tuple(
            Rejected(place_words(cause), percent(cause.left), "-")
            for cause in report.causes
            if spot_of(cause) not in tied
        )
    shown = [tie.trial for tie in ties(report)]
    found = []
    for trial in report.figures.trials:
        members = {spot_of(each) for each in trial.effects}
        alone = len(members) == 1 and members <= tied and len(answer) <= 1
        if not members or members == answer or alone or any(trial is each for each in shown):
            continue
        name = listed([place_words(each) for each in trial.effects])
        behind = f"{number(trial.behind, 2)} ± {number(trial.behind_sd, 1)}" if trial.behind_sd > 0.0 else "best"
        found.append(Rejected(f"{name} alone" if members < answer else name, percent(trial.left), behind))
    return tuple(found)


def screened_words(report: GapReport) -> str:
    """Locations that were dropped after a first fit."""
    if report.figures is None or not report.figures.screened:
        return ""
    places: dict[str, list[str]] = {}
    for member in report.figures.screened:
        places.setdefault(effect_words(member.effect), []).append(site_words(member.site, member.motor))
    named = "; ".join(f"{name} ({listed(at)})" for name, at in sorted(places.items()))
    return f"{len(report.figures.screened)} more candidates were dropped after a first fit: {named}."


def findings(report: GapReport) -> tuple[tuple[str, str, str], ...]:
    """(severity, logs, text) of the data check; a finding that several logs share is listed once."""
    grouped: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in report.data_check:
        grouped.setdefault((finding.severity, finding.check, finding.signal), []).append(finding)
    found = []
    for (severity, _, _), group in grouped.items():
        logs = list(dict.fromkeys(each.log for each in group))
        same = len({each.text for each in group}) == 1
        text = group[0].text if same else f"{group[0].text} (the first; the others are similar)"
        found.append((severity, log_words(logs), plain(text)))
    return tuple(found)
