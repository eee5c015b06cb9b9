"""Summary of the cases: cells of the table, and counts of right, wrong and confidently wrong answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from via_validation.gap_real.cases import Case
from via_validation.gap_real.run import Result
from via_validation.gap_real.truth import CONFIDENT, FACTOR, confidently_wrong, named_causes, outcome, sizes

Pair = tuple[Case, Result]


@dataclass(frozen=True)
class Summary:
    """Counts over cases.

    known     cases with a documented cause; of those `named` and `tied`
    wrong     cases, controls among them
    controls  cases without a documented cause; of those `honest`
    confidently_wrong  wrong answers with a probability of CONFIDENT or more
    compared  other recordings on which a repair was tried; of those `worse`
    sized     named causes with a documented size; of those `off` by more than FACTOR
    failed    cases whose diagnosis raised an error
    seconds   processor time
    """

    known: int
    named: int
    tied: int
    wrong: int
    controls: int
    honest: int
    confidently_wrong: int
    compared: int
    worse: int
    sized: int
    off: int
    failed: int
    seconds: float

    def __str__(self) -> str:
        parts = (
            f"{self.named} named and {self.tied} rightly tied of {self.known} cases with a known cause",
            f"{self.wrong} wrong, {self.confidently_wrong} of these with a probability of {CONFIDENT:g} or more",
            f"{self.failed} failed",
            f"{self.honest} of {self.controls} controls honest",
            f"{self.off} of {self.sized} sizes off by more than a factor of {FACTOR:g}",
            f"{self.worse} of {self.compared} other recordings worse with the repair",
            f"{self.seconds:.0f} s of processor time",
        )
        return "; ".join(parts)


def summary(pairs: Sequence[Pair]) -> Summary:
    """The counts over all cases."""
    outcomes = [(case, outcome_of(case, result)) for case, result in pairs]
    known = [word for case, word in outcomes if not case.truth.control]
    controls = [word for case, word in outcomes if case.truth.control]
    found = [size for case, result in pairs if result.report for size in sizes(named_causes(result.report), case.truth)]
    elsewhere = [each for _, result in pairs for each in result.elsewhere if not each.failure]
    return Summary(
        len(known), known.count("named"), known.count("rightly tied"), [*known, *controls].count("wrong"),
        len(controls), controls.count("honest"),
        sum(result.report is not None and confidently_wrong(result.report, case.truth) for case, result in pairs),
        len(elsewhere), sum(each.worse for each in elsewhere), len(found), sum(each.off for each in found),
        [*known, *controls].count("failed"), sum(result.seconds for _, result in pairs),
    )  # fmt: skip


def outcome_of(case: Case, result: Result) -> str:
    """The outcome of a case; 'failed' if the diagnosis raised an error."""
    return "failed" if result.report is None else outcome(result.report, case.truth)


def first_cause(result: Result) -> str:
    """The first cause with its parameters."""
    if result.report is None or not result.report.causes:
        return ""
    cause = result.report.causes[0]
    values = ", ".join(f"{name} {v.value:.3g} +- {v.sd:.1g} {v.unit}" for name, v in cause.parameters.items())
    return f"{cause.effect}: {values}" if values else cause.effect


def gap_words(result: Result) -> str:
    """The gap before and after the repair on held-out data [%]."""
    gap = result.report.gap if result.report is not None else None
    return "" if gap is None else f"{100 * gap.before:.3g} -> {100 * gap.after:.3g} %"


def worse(result: Result) -> str:
    """Number of other recordings on which the repair increases the gap."""
    compared = [each for each in result.elsewhere if not each.failure]
    return f"{sum(each.worse for each in compared)} of {len(compared)}" if compared else ""


def probability(result: Result) -> str:
    """Probability of the first cause; empty without a cause."""
    report = result.report
    return f"{report.causes[0].probability:.2f}" if report is not None and report.causes else ""
