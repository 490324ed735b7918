"""Waiting for a server or a network that does not respond.

obstore's own retries are not used. They count from the beginning of a request, so a request that fails late is not
repeated. They also hide whether an earlier attempt at a conditional write took effect.
"""

import errno
import math
import random
import re
import time
from collections.abc import Callable
from typing import TypeVar

from atlas.errors import NetworkError, without_secrets

SHORT_PATIENCE = 15.0
"""Seconds to wait for a store while a user waits for the response: the URL may be wrong."""
LONG_PATIENCE = 180.0
"""Seconds that a run waits for a store that it has reached before."""
_FIRST_PAUSE, _LONGEST_PAUSE = 0.1, 5.0
_PASSING = re.compile(r"(?<!Generic )HTTP error|status code: (?:408|429|5(?!01)\d\d)|\(RequestTimeout\b")
"""Pattern of obstore's messages for failures that may pass: no or a cut connection, an overloaded or broken server."""
_REFUSED = re.compile(r"status code: 40[013]\b")
"""Pattern of messages for requests that a server rejects for every object: S3 answers 400 to an expired credential."""
_T = TypeVar("_T")


def retry_call(call: Callable[[], _T], url: str, patience: float) -> _T:
    """Return the result of a call to obstore, repeated with growing pauses while the store does not respond.

    Raise NetworkError, which names the URL, after ``patience`` seconds. Raise OSError at once for failures that do not
    pass. A failed call may still have taken effect.
    """
    from obstore.exceptions import BaseError, PermissionDeniedError, UnauthenticatedError

    begin, pause = math.inf, _FIRST_PAUSE
    while True:
        try:
            return call()
        except BaseError as error:
            line = first_line(error)
            if not _PASSING.search(line):
                if isinstance(error, PermissionDeniedError | UnauthenticatedError) or _REFUSED.search(line):
                    hint = "; check that the credentials are still valid" if line.endswith("400 Bad Request") else ""
                    raise PermissionError(errno.EACCES, line + hint) from None
                raise OSError(line) from None
        begin = min(begin, time.monotonic())
        tried = time.monotonic() - begin
        if tried >= patience:
            raise NetworkError(f"{without_secrets(url)}: no answer for {tried:.0f} s ({line})")
        time.sleep(min(pause * random.uniform(0.5, 1.0), patience - tried))  # not all workers at once
        pause = min(2.0 * pause, _LONGEST_PAUSE)


def first_line(error: Exception) -> str:
    """Return the first line of an error without obstore's details; from a server's XML, its code and message."""
    first, _, answer = str(error).partition("\n\nDebug source")[0].partition("<")
    lines = first.splitlines()
    text = (lines[0].rstrip(": ") if lines else "") or type(error).__name__
    matches = [re.search(rf"<{name}>([^<]*)</{name}>", answer) for name in ("Code", "Message")]
    reason = ": ".join(" ".join(match[1].split()) for match in matches if match)
    return without_secrets(f"{text} ({reason})" if reason else text)
