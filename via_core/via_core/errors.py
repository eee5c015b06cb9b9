"""Errors of the suite: all derive from `ViaError` and carry the offending value."""

LONGEST, END = 1500, 300  # characters of a text, and of its end where a longer one is cut


class ViaError(Exception):
    """Base class of all errors that are raised on purpose; the text is one line with the value and the remedy.

    A text is cut in its middle where values or lists of a file make it longer than LONGEST.
    """

    def __init__(self, text: object = "") -> None:
        whole = str(text)
        super().__init__(whole if len(whole) <= LONGEST else f"{whole[: LONGEST - END]} .. {whole[-END:]}")


def one_line(error: BaseException) -> str:
    """The text of an exception of a library in one line of at most 200 characters; without text, its class."""
    return " ".join(str(error).split())[:200] or type(error).__name__


class SignalError(ViaError):
    """Invalid signals: wrong shape, not finite, or time that does not increase."""


class DeviceError(ViaError):
    """Invalid device file; the text names the file, the key and the allowed range."""


class BagError(ViaError):
    """A bag that cannot be read or written."""


class ImportMapError(ViaError):
    """A recording whose columns do not match its mapping file."""


class ParameterError(ViaError):
    """A parameter outside the valid range of an algorithm, plant or effect."""
