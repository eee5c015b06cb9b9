"""One family of errors: whatever goes wrong at our door derives from `ViaError` and carries the offending value."""


class ViaError(Exception):
    """Base of every error this project raises on purpose; its text is one line that names the value and the remedy."""


class SignalError(ViaError):
    """Signals that cannot be what they claim: wrong shape, not finite, time that does not increase."""


class DeviceError(ViaError):
    """A device file that cannot describe a device; the text names the file, the key and the allowed range."""


class BagError(ViaError):
    """A bag that cannot be read or written as asked."""


class ImportMapError(ViaError):
    """A recording whose columns do not fit its mapping file."""


class ParameterError(ViaError):
    """A parameter outside the range in which an algorithm, plant or effect means anything."""
