"""Services of a simulator node that change its effects while it runs.

offers      ~/set_effects       via_interfaces/SetEffects: replaces all effects, or answers why these do not fit
            ~/clear_effects     via_interfaces/ClearEffects: back to the nominal model
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from via_core.errors import ParameterError
from via_interfaces.srv import ClearEffects, SetEffects

from via_sim.effects import Effect, place_name
from via_sim.effects.files import load_effects
from via_sim.effects.own import load_all


class EffectServices:
    """The services of `node`; `change` takes the new effects and raises ParameterError for one that does not fit."""

    def __init__(self, node: Any, change: Callable[[Sequence[Effect]], None]) -> None:
        self._change = change
        self.active = ""  # as text
        node.create_service(SetEffects, "~/set_effects", node.gate.request(self._set))
        node.create_service(ClearEffects, "~/clear_effects", node.gate.request(self._clear))

    def apply(self, effects: Sequence[Effect]) -> None:
        """Change to these effects; raises ParameterError for one that does not fit."""
        self._change(effects)
        self.active = ", ".join(f"{e.name} at {place_name(e.site, e.motor)}" for e in effects) or "nominal model"

    def load(self, path: str, own: Iterable[str] = ()) -> None:
        """Change to the effects of a file, without a path to none; raises ParameterError.

        own  modules and files that add effects to the catalogue before
        """
        load_all(own)
        self.apply(load_effects(path) if path else ())

    def _set(self, request: SetEffects.Request, answer: SetEffects.Response) -> SetEffects.Response:
        try:
            self.apply([_effect(message) for message in request.effects])
        except ParameterError as error:
            answer.success, answer.message = False, str(error)
            return answer
        answer.success, answer.message = True, self.active
        return answer

    def _clear(self, _: ClearEffects.Request, answer: ClearEffects.Response) -> ClearEffects.Response:
        self.apply(())
        answer.success, answer.message = True, self.active
        return answer


def _effect(message: Any) -> Effect:
    """The effect of a message; raises ParameterError."""
    names, values = list(message.parameter_names), list(message.parameter_values)
    if len(names) != len(values):
        raise ParameterError(f"{message.name}: {len(names)} parameter names for {len(values)} values")
    return Effect(message.name, message.site, dict(zip(names, values)), int(message.motor), message.joint)
