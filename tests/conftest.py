"""What all tests share."""

from __future__ import annotations

import signal

# A shell that starts the tests in the background has them, and every process they start, ignore Ctrl-C;
# some tests press it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
