"""Errors of the suite: all derive from `ViaError` and carry the offending value."""


class ViaError(Exception):
    """Base class of all errors that are raised on purpose; the text is one line with the value and the remedy."""


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
