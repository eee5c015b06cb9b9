"""Reports of every verdict for the tests of words and pages: figures of a small real diagnosis, planted answers."""

from functools import cache

from gap_logs import flexible, log_of
from via_gap.diagnosis import diagnose
from via_gap.logs.findings import Finding
from via_gap.report.figures import Member, OrderSpectrum, Trial
from via_gap.report.report import Cause, EffectLocation, GapReport, Proposal, Value, Where
from via_gap.selection.gap import Gap, SignalGap

HOSTILE = "<script>document.title='taken'</script> & \"run\" 1.csv"  # a file may be called that
KINDS = (
    "effect", "tied", "several_effects", "main_effect", "no_gap", "unknown", "cannot_tell", "refused", "measurements",
)  # fmt: skip


def place(effect: str, site: str, motor: int = 0) -> EffectLocation:
    return EffectLocation(effect=effect, site=site, joint="joint", motor=motor)


BACKLASH, COULOMB = place("backlash", "transmission", 1), place("coulomb_friction", "motor", 1)
VISCOUS, STEPS = place("viscous_friction", "motor", 1), place("encoder_quantisation", "sensor")
RIPPLE = place("torque_ripple", "motor", 1)
SPECTRUM = OrderSpectrum(
    equation="motor 1", orders=(1.0, 2.0, 7.0), before=(0.01, 0.02, 0.03), after=(0.01, 0.01, 0.0), level=0.002,
    turns=1.5,
)  # fmt: skip
VALUES = {
    "backlash": {"gap": Value(value=0.02, sd=1e-4, unit="rad", low=0.0, high=0.5, neutral=0.0)},
    "coulomb_friction": {"torque": Value(value=0.0301, sd=4e-4, unit="N m", low=0.0, high=3.0, neutral=0.0)},
    "viscous_friction": {"coefficient": Value(value=0.05, sd=1e12, unit="N m s/rad", low=-0.1, high=2.0, neutral=0.0)},
    "torque_ripple": {
        "amplitude": Value(value=0.03, sd=1e-3, unit="N m", low=0.0, high=3.0, neutral=0.0),
        "order": Value(value=7.0, sd=1e-2, unit="1/rev", low=0.5, high=1e3, neutral=1.0),
        "phase": Value(value=0.4, sd=1e-2, unit="rad", low=-3.15, high=3.15, neutral=0.0),
    },
    "encoder_quantisation": {"quantum": Value(value=1e-3, sd=0.0, unit="rad")},
}


def cause(at: EffectLocation, probability: float, left: float = 0.01) -> Cause:
    return Cause(
        **at.model_dump(),
        probability=probability,
        share=probability,
        parameters=VALUES[at.effect],
        left=left,
        score=left,
    )


def trial(*places: EffectLocation, left: float, behind: float) -> Trial:
    members = tuple(Member(effect=p.effect, site=p.site, motor=p.motor) for p in places)
    return Trial(effects=members, left=left, behind=behind, behind_sd=0.03)


def where(at: EffectLocation, share: float, equation: str) -> Where:
    return Where(joint="joint", site=at.site, motor=at.motor, equation=equation, share=share)


GAP = Gap(
    by="segments", before=0.2, tuned=0.1, after=0.02, interval=(0.018, 0.023), floor=0.01, bound=0.015, explained=0.973,
    signals={
        "q": SignalGap(before=0.2, after=0.02, floor=0.01, bound=0.015, explained=0.973),
        "theta_1": SignalGap(before=0.1, after=0.02, floor=0.0, bound=0.01, explained=0.889),
    },
)  # fmt: skip


@cache
def healthy() -> GapReport:
    """A real report: no gap, which takes no candidate and so next to no time."""
    log = log_of(flexible(), (), seed=22)
    return diagnose([log], log.device)


@cache
def report_of(kind: str) -> GapReport:
    """A report for each of KINDS; all but 'no_gap' hold planted answers beside real figures."""
    base = healthy().model_copy(update={"logs": (HOSTILE,)})
    if kind == "no_gap":
        return base
    figures = base.figures
    assert figures is not None
    noticed = Finding(log=HOSTILE, check="jitter", signal="time", severity="note", value=0.1, text="stamps wobble")
    alone = trial(BACKLASH, left=0.01, behind=0.0)
    trials = (alone, trial(COULOMB, left=0.02, behind=0.02), trial(VISCOUS, left=1.1, behind=3.0))
    found = {
        "verdict": "effect", "explained": 0.973, "gap": GAP, "data_check": (noticed,),
        "not_evaluated": ("no motor torque was measured",),
        "where": (where(BACKLASH, 0.9, "link and motor 1"), where(COULOMB, 0.1, "motor 1")),
        "causes": (cause(BACKLASH, 0.97), cause(COULOMB, 0.02, 0.3), cause(VISCOUS, 0.001, 1.1)),
        "equivalence_set": (BACKLASH,), "effects": (BACKLASH,),
        "figures": figures.model_copy(
            update={"trials": trials, "screened": (trials[-1].effects[0],), "spectra": (SPECTRUM,)}
        ),
    }  # fmt: skip
    changes = {
        "effect": {},
        "tied": {
            "causes": (cause(COULOMB, 0.6), cause(VISCOUS, 0.4)),
            "equivalence_set": (COULOMB, VISCOUS),
            "effects": (COULOMB,),
            "proposal": Proposal(
                separates=(COULOMB, VISCOUS), expected_disagreement=12.0, duration=8.0, file="motion.csv"
            ),
        },
        "several_effects": {
            "verdict": "several_effects",
            "causes": (cause(BACKLASH, 0.95), cause(COULOMB, 0.95)),
            "equivalence_set": (BACKLASH, COULOMB),
            "effects": (BACKLASH, COULOMB),
        },
        "main_effect": {
            "verdict": "main_effect",
            "explained": 0.84,
            "causes": (cause(RIPPLE, 0.8, 0.05), cause(COULOMB, 0.1, 0.4)),
            "equivalence_set": (RIPPLE,),
            "effects": (RIPPLE,),
            "gap": GAP.model_copy(update={"after": 0.06, "interval": (0.05, 0.07), "explained": 0.84}),
        },
        "unknown": {
            "verdict": "unknown",
            "explained": 0.0,
            "causes": (cause(BACKLASH, 0.2, 0.6), cause(COULOMB, 0.1, 0.7)),
            "equivalence_set": (),
            "effects": (),
            "gap": GAP.model_copy(update={"after": 0.1, "interval": (0.09, 0.12), "explained": 0.54}),
        },
        "cannot_tell": {
            "verdict": "cannot_tell",
            "reason": "4 causes explain these data equally well",
            "equivalence_set": (BACKLASH, COULOMB, VISCOUS, RIPPLE),
        },
        "refused": {
            "verdict": "cannot_tell", "explained": 0.0, "where": (), "causes": (), "equivalence_set": (), "effects": (),
            "gap": None, "nuisance": (), "figures": None,
            "data_check": (noticed.model_copy(update={"severity": "refuse", "text": "neither commands nor torques"}),),
        },
        "measurements": {
            "where": (where(STEPS, 1.0, "measurements"),), "causes": (cause(STEPS, 0.98),),
            "equivalence_set": (STEPS,), "effects": (STEPS,),
        },
    }[kind]  # fmt: skip
    return GapReport.model_validate(base.model_copy(update={**found, **changes}).model_dump())
