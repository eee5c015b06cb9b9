"""An estimator around another one: what it passes on unchanged. Its state begins with the state of the one inside."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

from via_core.devices import Device
from via_core.signals import Array

from via_estimators.contract import Estimator, Parameters


@dataclass(frozen=True)
class Wrapped(Estimator):
    """`inner` with its parameters, inputs, outputs and condition number."""

    inner: Estimator

    @classmethod
    def from_device(cls, device: Device) -> Self:
        """Use `methods.estimator_for`, which gets the method."""
        raise NotImplementedError("methods.estimator_for(device, method) returns these estimators")

    @property
    def parameters(self) -> Parameters:  # type: ignore[override]
        """Those of the estimator inside."""
        return self.inner.parameters

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.inner.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.inner.outputs

    def with_parameters(self, parameters: Parameters) -> Self:
        return replace(self, inner=self.inner.with_parameters(parameters))

    def condition(self, state: Array) -> float:
        return self.inner.condition(state[: self._size])

    @cached_property
    def _size(self) -> int:
        """Size of the state of the estimator inside."""
        return len(self.inner.init())
