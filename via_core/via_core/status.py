"""What an estimate is worth. The numbers are those of the messages in via_interfaces; a test holds the two together."""

from enum import IntEnum


class Status(IntEnum):
    """Nature answers with a status; only misuse raises."""

    OK = 0  # the estimate and its standard deviation mean what they say
    WARMING_UP = 1  # not enough samples yet: the value is the prior, the standard deviation its width
    NOT_EXCITED = 2  # the motion no longer tells: the last value is held, the standard deviation grows
    OUTSIDE_RANGE = 3  # extrapolated beyond the deflections visited so far
    BAD_SAMPLE = 4  # this sample was skipped (not finite, or its stamp did not increase): the last value is held
