"""Commands of this package for `via`, registered in the entry point group `via.commands`."""

from via_bringup.cli.deferred import Entry

COMMANDS = {
    "tables": Entry("via_validation.commands.tables:tables"),
    "compare": Entry("via_validation.commands.compare:compare"),
    "changes": Entry("via_validation.commands.changes:changes"),
    "faults": Entry("via_validation.commands.faults:faults"),
    "reliability": Entry("via_validation.commands.reliability:reliability"),
    "soak": Entry("via_validation.commands.soak:soak"),
    "fuzz": Entry("via_validation.commands.fuzz:fuzz"),
    "mutants": Entry("via_validation.commands.mutants:mutants"),
    "bench": Entry("via_validation.commands.bench:app", text="Measure speed, memory and endurance."),
    "gap blind": Entry(
        "via_validation.commands.gap_blind:app", text="Evaluate the diagnosis on sealed cases of a second simulator."
    ),
    "gap exports": Entry("via_validation.commands.gap_exports:exports"),
    "gap real": Entry("via_validation.commands.gap_real:real"),
}
