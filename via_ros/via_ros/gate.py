"""Gate of a node: a bad message or request is refused, counted and reported, and never ends the node.

A callback behind the gate may raise for a message that it cannot use: a status that does not exist, a duration that
overflows, a reference out of reach. Messages that are never decoded because of their size: see `serialised`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from via_core.errors import ViaError
from via_core.text_files import shown

# What the content of a message can cause; any other exception is a fault of the program.
BAD = (ViaError, ValueError, ArithmeticError, struct.error)


class Gate:
    """Counts what the callbacks of a node refuse; the reason of each first refusal in a row is logged."""

    def __init__(self, logger: Any) -> None:
        self.refused = 0
        self.reason = ""  # of the last refusal
        self._logger = logger

    def message(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """The callback of a subscription."""

        def admitted(message: Any) -> None:
            try:
                callback(message)
            except BAD as error:
                self._refuse(error)

        return admitted

    def request(self, callback: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """The callback of a service whose response has `success` and `message`."""

        def admitted(request: Any, response: Any) -> Any:
            try:
                return callback(request, response)
            except BAD as error:
                self._refuse(error)
                response.success, response.message = False, self.reason
                return response

        return admitted

    def _refuse(self, error: Exception) -> None:
        self.refused += 1
        reason = shown(" ".join(str(error).split())[:200]) or type(error).__name__
        if reason != self.reason:
            self._logger.warning(f"refused: {reason}")
        self.reason = reason
