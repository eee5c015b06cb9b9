"""The search: which candidates are fitted to the end."""

import numpy as np
from gap_logs import log_of, rigid
from via_core.devices import load_device
from via_core.signals import Signals
from via_gap.candidates.screen import ranked
from via_gap.diagnosis import diagnose
from via_gap.logs.log import JointLog
from via_gap.residual.recordings import Recordings
from via_gap.selection.comparison import candidates_of
from via_gap.selection.experiment import Experiment
from via_gap.selection.search import Search
from via_sim.effects import Effect
from via_sim.plants import JointPlant
from via_sim.sensors import Sensors
from via_sim.simulate import InitialConditions, simulate

DEVICE = load_device("xl330_kp800")
LOADED = (
    Effect("load_dependent_friction", "link", {"coefficient": 0.4}),
    Effect("payload", "link", {"mass": 0.3, "distance": 0.1}),
)


def servo_log(wish, seed: int) -> JointLog:
    """Angle and goal of the position drive with both effects, for a goal `wish` of time."""
    rate, duration = DEVICE.sensors.rate, 6.0
    time = np.arange(round(duration * rate)) / rate
    commands = Signals(time, {"equilibrium": wish(time)}, {"equilibrium": "rad"}, frozenset({"equilibrium"}))
    plant = JointPlant.from_device(DEVICE).with_effects(LOADED)
    measured = simulate(
        plant, commands, duration, rate, Sensors.of_device(DEVICE), InitialConditions(seed=seed)
    ).measured
    return JointLog(f"log {seed}", DEVICE, measured.select(["q"]), commands)


def test_a_cause_that_a_linear_prediction_ranks_low_is_fitted():
    """Friction that grows with a load twice as large as filed: no small change of the file resembles it."""
    logs = [
        servo_log(lambda t: np.sin(t) + 0.5 * np.sin(5.0 * t), 1),
        servo_log(lambda t: np.sin(1.7 * t) + 0.4 * np.sin(4.1 * t), 2),
    ]
    recordings = Recordings.of(logs, None, DEVICE)
    experiment = Experiment.of(recordings.fitted, recordings.held_out)
    search = Search.of(
        experiment.fitted, experiment.evaluate, lambda _: True, experiment.tuned, candidates_of(experiment)
    )
    places = ranked(search.start, search.jacobian, search.tried)
    predicted = [place.name for _, place, _ in places].index("load_dependent_friction")
    fits = search._raced(search.start, [[(p, v)] for _, p, v in places], search.jacobian, 4)
    best = min(fits, key=lambda each: each.loss)
    assert predicted > 4 and len(fits) == 4  # the prediction alone would have left it out
    assert best.locations[0].name == "load_dependent_friction" and best.loss < 0.05 * search.start.loss


def test_small_effects_are_sought_although_less_than_one_standard_deviation_is_left():
    """The first of two effects leaves a mean z^2 below 2, and the search still tries a second one."""
    ripple = Effect("torque_ripple", "motor", {"amplitude": 0.0004, "order": 9.0, "phase": 0.3}, 1)
    planted = (Effect("coulomb_friction", "link", {"torque": 0.0025}), ripple)
    report = diagnose([log_of(rigid(), planted, seed=3, duration=10.0)], rigid())
    assert report.gap.after < np.sqrt(2.0) * report.gap.floor and len(report.effects) == 1
    assert any(len(trial.effects) == 2 for trial in report.figures.trials)
