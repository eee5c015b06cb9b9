"""Commands of this package for `via`, registered in the entry point group `via.commands`."""

from via_bringup.cli.deferred import Entry

COMMANDS = {
    "tables": Entry(
        "via_validation.commands.tables:tables",
        "Reproduce the tables and figures of the document: its numbers, ours, and the limits.",
    ),
    "compare": Entry(
        "via_validation.commands.compare:compare",
        "Compare accuracy, convergence, coverage, robustness and cost of all stiffness estimators.",
    ),
    "changes": Entry(
        "via_validation.commands.changes:changes",
        "Report bias, random error, fastest change followed and coverage of every estimator on joints that change.",
    ),
    "faults": Entry(
        "via_validation.commands.faults:faults",
        "Feed faulty and sound signals to every estimator and report its status.",
    ),
    "reliability": Entry(
        "via_validation.commands.reliability:reliability",
        "Inject faults into the live graph and check what each node does (five minutes).",
    ),
    "soak": Entry(
        "via_validation.commands.soak:soak",
        "Run the live graph at 1 kHz and check that no message is lost and no memory grows (30 minutes).",
    ),
    "fuzz": Entry(
        "via_validation.commands.fuzz:fuzz",
        "Damage files and give them to the loaders: each must be read or refused in one line.",
    ),
    "mutants": Entry(
        "via_validation.commands.mutants:mutants",
        "Plant small errors in the numerical heart and count those that the tests notice (hours for 200).",
    ),
    "bench": Entry("via_validation.commands.bench:app", "Measure speed, memory and endurance."),
    "gap blind": Entry(
        "via_validation.commands.gap_blind:app", "Evaluate the diagnosis on sealed cases of a second simulator."
    ),
    "gap exports": Entry(
        "via_validation.commands.gap_exports:exports",
        "Export repairs of sealed cases and real robots to MuJoCo, URDF and SDF, and compare the gap in MuJoCo.",
    ),
    "gap real": Entry(
        "via_validation.commands.gap_real:real",
        "Diagnose real robots from public recordings and compare the answers with the documented causes.",
    ),
}
