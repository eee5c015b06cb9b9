"""Faults of processes: killed, paused, restarted, doubled, one after another."""

from __future__ import annotations

import signal
from collections.abc import Callable

from via_core.bags.reader import read_bag

from via_validation.reliability.fault import Fault, expect
from via_validation.reliability.graph import Graph
from via_validation.reliability.lab import CHUNK, SAMPLES, WITHIN, Lab, ends

PAUSE = 2.0  # [s] of stamps
PASSED = 0.5  # [s] of stamps before a fault
GAP = 200.0  # [ms] largest step of stamps that a dying listener may cause

# ---- controller


def _controller_killed(lab: Lab) -> str:
    after = lab.torque_after(lab.controller.kill())
    lab.passes(PASSED)
    lab.graph.all_run(lab.controller)
    lab.end_recorder()
    return f"last torque {after:.1f} ms after the kill; {lab.wrong()}; the bag is complete"


def _controller_paused(lab: Lab) -> str:
    after = lab.torque_after(lab.controller.signal(signal.SIGSTOP))
    lab.passes(PAUSE)
    expect(lab.torque() == 0.0, "torque while the controller is paused")
    lab.controller.signal(signal.SIGCONT)
    lab.goes_on("after the pause")
    lab.end_recorder()
    return f"last torque {after:.1f} ms after the pause began, torque again after it; {lab.wrong()}"


def _controller_terminated(number: int) -> Callable[[Lab], str]:
    def check(lab: Lab) -> str:
        lab.controller.signal(number)
        ends(lab.graph, lab.controller, 0)
        lab.passes(PASSED)
        expect(lab.torque() == 0.0, "torque without a controller")
        lab.graph.all_run(lab.controller)
        return "exit code 0, no torque afterwards, the others run"

    return check


def _controller_restarted(lab: Lab) -> str:
    killed = []
    for turn in range(3):
        killed.append(lab.controller)
        after = lab.torque_after(lab.controller.kill())
        lab.controller = lab.start_controller()
        lab.goes_on(f"after restart {turn + 1}", *killed)
    return f"torque again after each of 3 restarts, last torque {after:.1f} ms after the last kill; {lab.wrong()}"


def _controller_doubled(lab: Lab) -> str:
    second = lab.start_controller("second")
    lab.graph.reported("commanders: /excitation, /second")
    lab.graph.until(lambda: lab.torque() == 0.0, "an end of the torque")
    lab.passes(PASSED)
    expect(lab.torque() == 0.0, "torque under two controllers")
    second.kill()
    lab.goes_on("after the second controller", second)
    return f"no torque under two controllers, both named; torque again without the second; {lab.wrong()}"


# ---- simulator


def _simulator_killed(lab: Lab) -> str:
    lab.simulator.kill()
    lab.graph.reported("no samples")
    lab.graph.pause(1.0)
    lab.graph.all_run(lab.simulator)
    first, lab.simulator = lab.simulator, lab.start_simulator()
    lab.goes_on("after the restart of the simulator", first)
    bag = lab.end_recorder()
    return f"reported, the others run and go on with a new simulator; {lab.recorded(bag)}; {lab.wrong()}"


def _simulator_paused(lab: Lab) -> str:
    lab.simulator.signal(signal.SIGSTOP)
    lab.graph.reported("no samples")
    lab.graph.pause(PAUSE)
    lab.simulator.signal(signal.SIGCONT)
    lab.goes_on("after the pause")
    lab.end_recorder()
    return f"reported; torque and estimates again, after {lab.largest_gap():.0f} ms without samples; {lab.wrong()}"


def _simulator_doubled(lab: Lab) -> str:
    second = lab.start_simulator(listeners=1)
    lab.graph.reported("drivers: /simulator, /simulator")
    lab.passes(PAUSE)
    early = lab.backward()
    lab.begin()
    lab.passes(PAUSE)
    expect(lab.backward() == 0, f"samples of both simulators alternate; the second: {second.errors()[-150:]}")
    expect(lab.torque() > 0.0, "no torque under the first simulator")
    lab.simulator.kill()
    lab.goes_on("of the second simulator", lab.simulator)
    expect(second.code is None, "the second simulator has ended")
    waits = "waits" if not early else f"gives way ({early} samples alternated)"
    return f"the second one {waits}, both are named; it drives the joint when the first has died; {lab.wrong()}"


# ---- estimator


def _estimator_killed(lab: Lab) -> str:
    lab.estimator.kill()
    lab.passes(PAUSE)
    lab.graph.all_run(lab.estimator)
    gap = lab.largest_gap()
    expect(gap < GAP, f"{gap:.0f} ms without samples")
    expect(lab.torque() > 0.0, "no torque")
    bag = lab.end_recorder()
    return f"the loop goes on, at most {gap:.0f} ms between samples; {lab.recorded(bag)}"


def _estimator_paused(lab: Lab) -> str:
    lab.estimator.signal(signal.SIGSTOP)
    lab.passes(PAUSE)
    gap = lab.largest_gap()
    expect(gap < GAP, f"{gap:.0f} ms without samples")
    lab.estimator.signal(signal.SIGCONT)
    lab.goes_on("after the pause")
    bag = lab.end_recorder()
    return f"the loop goes on, at most {gap:.0f} ms between samples; {lab.recorded(bag)}; {lab.wrong()}"


def _estimator_restarted(lab: Lab) -> str:
    first = lab.estimator
    first.kill()
    lab.estimator = lab.start_estimator()
    lab.goes_on("of the new estimator", first)
    return f"estimates of the new one; {lab.wrong()}"


def _estimator_doubled(lab: Lab) -> str:
    second = lab.start_estimator()
    lab.passes(PAUSE)
    lab.goes_on("of two estimators")
    second.kill()
    lab.goes_on("without the second estimator", second)
    return f"both estimate; {lab.wrong()}"


# ---- recorder


def _recorder_killed(lab: Lab) -> str:
    lab.recorder.signal(signal.SIGSTOP)  # its present state, however slow the machine is
    last = lab.stamp()
    lab.recorder.kill()
    lab.passes(PASSED)
    lab.graph.all_run(lab.recorder)
    bag = read_bag(lab.graph.folder / "bag")
    lost = last - int(bag[SAMPLES].stamp.max())
    expect(lost <= CHUNK, f"the last {1e-6 * lost:.0f} ms are lost")
    return f"{lab.recorded(bag)} before the last {max(1e-6 * lost, 0.0):.0f} ms; the others run"


def _recorder_paused(lab: Lab) -> str:
    lab.recorder.signal(signal.SIGSTOP)
    lab.passes(PAUSE)
    lab.recorder.signal(signal.SIGCONT)
    lab.goes_on("after the pause")
    bag = lab.end_recorder()
    return f"queues hold {PAUSE:g} s: {lab.recorded(bag)}"


def _recorder_doubled(lab: Lab) -> str:
    second = lab.start_recorder()
    ends(lab.graph, second, 2)
    expect("exists already" in second.errors(), f"output: {second.errors()[-200:]}")
    bag = lab.end_recorder()
    return f"the second one refuses with one line; {lab.recorded(bag)}"


def _recorder_interrupted_twice(lab: Lab) -> str:
    lab.recorder.signal(signal.SIGINT)
    lab.recorder.signal(signal.SIGINT)
    lab.recorder.signal(signal.SIGTERM)
    ends(lab.graph, lab.recorder, 0)
    bag = read_bag(lab.graph.folder / "bag")
    expect(bag.complete, f"not complete: {'; '.join(bag.remarks)}")
    return f"exit code 0, complete bag: {lab.recorded(bag)}"


# ---- several


def _all_killed(lab: Lab) -> str:
    lab.recorder.kill()
    lab.estimator.kill()
    after = lab.torque_after(lab.controller.kill())
    gap = lab.largest_gap()
    expect(gap < GAP, f"{gap:.0f} ms without samples")
    lab.graph.all_run(lab.recorder, lab.estimator, lab.controller)
    return f"last torque {after:.1f} ms after the kill; the simulator runs, at most {gap:.0f} ms between samples"


def _in_lab(injected: str, must: str, check: Callable[[Lab], str]) -> Fault:
    def run(graph: Graph) -> str:
        lab = Lab(graph)
        lab.passes(PASSED)
        lab.begin()
        return check(lab)

    return Fault(injected, must, run, quick=False)


def faults() -> list[Fault]:
    """The faults of this group."""
    off = f"torque off within {1e-6 * WITHIN:g} ms of stamps; the others go on"
    again = "the others go on, and it too when it is back"
    kept = "the bag is complete, nothing is missing"
    unmoved = f"the loop goes on with gaps below {GAP:g} ms; {kept}"
    return [
        _in_lab("controller: SIGKILL", f"{off}; {kept}", _controller_killed),
        _in_lab("controller: SIGSTOP for 2 s", f"{off}; torque again after it", _controller_paused),
        _in_lab("controller: SIGTERM", "exit code 0; no torque; the others go on", _controller_terminated(15)),
        _in_lab("controller: SIGINT", "exit code 0; no torque; the others go on", _controller_terminated(2)),
        _in_lab("controller: killed and restarted three times", f"{off}; torque again", _controller_restarted),
        _in_lab("controller: doubled", "no torque, both named; torque again under one", _controller_doubled),
        _in_lab("simulator: SIGKILL and restart", f"reported; {again}; {kept}", _simulator_killed),
        _in_lab("simulator: SIGSTOP for 2 s", f"reported; {again}", _simulator_paused),
        _in_lab("simulator: doubled", "the second one waits, or gives way within 2 s; both named", _simulator_doubled),
        _in_lab("estimator: SIGKILL", unmoved, _estimator_killed),
        _in_lab("estimator: SIGSTOP for 2 s", f"{unmoved}; estimates again", _estimator_paused),
        _in_lab("estimator: killed and restarted", "estimates of the new one, none wrong", _estimator_restarted),
        _in_lab("estimator: doubled", "no estimate wrong; the others go on", _estimator_doubled),
        _in_lab("recorder: SIGKILL", "all messages but those of the last chunk; the others go on", _recorder_killed),
        _in_lab("recorder: SIGSTOP for 2 s", f"the others go on; {kept}", _recorder_paused),
        _in_lab("recorder: a second one for the same bag", f"the second one refuses; {kept}", _recorder_doubled),
        _in_lab("recorder: SIGINT twice and SIGTERM", kept, _recorder_interrupted_twice),
        _in_lab("recorder, estimator, controller: SIGKILL at once", off, _all_killed),
    ]
