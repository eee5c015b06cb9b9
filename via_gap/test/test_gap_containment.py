"""Device parameters that an effect contains keep their filed value; the effect takes up their error and tolerance."""

from __future__ import annotations

import numpy as np
import pytest
from gap_logs import flexible, log_of, rigid
from test_gap_location import SCALES
from via_core.devices import Device, load_device
from via_gap.candidates.fit import Axes, Fit
from via_gap.candidates.location import Location
from via_gap.candidates.refinement import refine
from via_gap.candidates.scales import scales_of
from via_gap.candidates.starts import starts
from via_gap.residual.nuisance import BOUND
from via_gap.residual.residual_model import ResidualModel
from via_gap.residual.segments import cut_log
from via_sim.catalogue import EFFECTS
from via_sim.effects import Effect, places
from via_sim.effects.device_numbers import with_spring_scales
from via_sim.plants import JointPlant


def model_of(device: Device) -> ResidualModel:
    return ResidualModel.of_plant(JointPlant.from_device(device))


def axes_of(problem: ResidualModel, location: Location, **values: float) -> Axes:
    """The coordinates of a fit with one effect at its initial values, or at these."""
    initial = {**starts(location, SCALES, problem.device)[0].directions[0], **values}
    return Axes.of(problem, [(location, list(initial.values()))], SCALES)


def held(device: Device) -> dict[str, list[str]]:
    """The device parameters that each effect contains, at every location."""
    problem, found = model_of(device), {}
    for kind in (kind for kind in EFFECTS.values() if not kind.measured):
        for site, motor in places(kind, device):
            axes = axes_of(problem, Location(kind.name, site, motor))
            names = [n.name for n, is_held in zip(problem.nuisances, axes.held, strict=True) if is_held]
            found |= {str(axes.locations[0]): names} if names else {}
    return found


def test_an_effect_contains_the_device_parameter_to_which_it_adds():
    for_each = {
        f"{effect} at {site}": [f"{site} viscous friction"]
        for effect in ("viscous_friction", "asymmetric_viscous")
        for site in ("link", "motor 1")
    }
    link = {"link_inertia at link": ["link inertia"], "gravity_error at link": ["gravity torque"]}
    assert held(flexible()) == {**for_each, **link, "spring_law at transmission 1": ["spring 1 torque"]}


def test_the_gain_of_the_drive_of_a_rigid_joint_contains_the_scale_of_its_torque():
    device = rigid()
    tolerances = device.tolerances.model_copy(update={"torque_scale": 0.05})
    assert held(device.model_copy(update={"tolerances": tolerances}))["torque_gain at motor 1"] == ["torque scale"]


def test_an_effect_of_both_springs_contains_the_torque_of_neither():
    found = held(load_device("qbmove_a"))
    assert found["spring_law at transmission 2"] == ["spring 2 torque"]
    assert "spring_law at both transmissions" not in found


@pytest.mark.parametrize(("name", "site"), [
    ("spring_law", "transmission"), ("viscous_friction", "motor"), ("asymmetric_viscous", "link"),
    ("link_inertia", "link"), ("gravity_error", "link"),
])  # fmt: skip
def test_an_effect_that_takes_up_an_offset_leaves_the_equations_as_they_were(name, site):
    problem = model_of(flexible())
    axes = axes_of(problem, Location(name, site, 0 if site == "link" else 1))
    offsets = np.where(axes.held, -BOUND, 0.5)
    values = list(starts(axes.locations[0], SCALES, problem.device)[0].directions[0].values())
    at = axes.coordinates(offsets, values)
    assert np.array_equal(at[: axes.count], np.where(axes.held, 0.0, offsets)) and axes.held.sum() == 1
    before = problem.row(
        [axes.locations[0].effect(dict(zip((p.name for p in axes.locations[0].parameters), values)))], offsets
    )
    after = problem.row(axes.effects(at), at[: axes.count])
    assert with_spring_scales(after) == pytest.approx(with_spring_scales(before), rel=1e-9)


def test_a_spring_law_beside_a_wrong_spring_is_known_to_the_tolerance_of_the_spring():
    """The fit begins at the end of the tolerance, where the device parameters alone end."""
    device = flexible()
    planted = Effect("spring_law", "transmission", {"scale": 1.3, "hardening": 2.0}, 1)
    segments = cut_log(log_of(device, (planted,), seed=7, duration=6.0, tolerance=0.0))
    problem = ResidualModel.of([segments], [np.arange(1, len(segments))])
    of_spring = [n.name == "spring 1 torque" for n in problem.nuisances]
    offsets = np.where(of_spring, BOUND, 0.0)
    residual = problem.residual([problem.row((), offsets)])[0]
    base = Fit((), offsets, float(residual @ residual), residual, np.empty((0, 0)))
    scales = scales_of([segments], [None])
    fit = refine(problem, base, [(Location.of(planted), (1.1, 0.5))], scales)
    assert fit is not None and fit.offsets[of_spring] == [0.0]
    scale, sd = fit.values[0], fit.sd[0]
    assert scale == pytest.approx(1.3, rel=0.01)
    assert sd == pytest.approx(device.tolerances.spring * scale, rel=0.1)
    assert fit.tolerances == pytest.approx(np.array([[device.tolerances.spring * scale, 0.0]]))


def test_no_effect_of_a_rigid_joint_takes_up_an_error_of_one_sign():
    """A payload adds inertia and gravity, but takes none away."""
    assert not any(name.startswith(("payload", "coulomb_friction", "stribeck_friction")) for name in held(rigid()))
