"""Validity of an estimate, numbered as in the messages of via_interfaces (a test compares them)."""

from enum import IntEnum


class Status(IntEnum):
    """Programming errors raise; bad data is reported as a status."""

    OK = 0  # the estimate and its standard deviation are valid
    WARMING_UP = 1  # too few samples so far: value and standard deviation are those of the prior
    NOT_EXCITED = 2  # the motion carries no information: the last value is repeated, the standard deviation grows
    OUTSIDE_RANGE = 3  # extrapolated beyond the deflections measured so far
    BAD_SAMPLE = 4  # sample skipped (not finite, or its stamp did not increase): the last value is repeated
    IMPLAUSIBLE = 5  # no device near the device file explains signals or value: a channel, unit or sign is wrong


# The same numbers as plain integers: compiled code cannot store a member of an enumeration in an array of floats.
OK, WARMING_UP, NOT_EXCITED, OUTSIDE_RANGE, BAD_SAMPLE, IMPLAUSIBLE = (int(status) for status in Status)
