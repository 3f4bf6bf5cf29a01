"""`python -IS _launch.py PARENT SIGNAL UID PROGRAM...`: becomes PROGRAM, which the kernel ends with its parent.

UID other than 0: gives root up but for access to files, as PostgreSQL does not run as root and the folders of tests are
root's alone. A file of its own, not a preexec_fn: other threads run in the parent.
"""

from __future__ import annotations

import ctypes
import os
import sys

_PR_SET_PDEATHSIG, _PR_SET_KEEPCAPS, _PR_CAP_AMBIENT, _PR_CAP_AMBIENT_RAISE = 1, 8, 47, 2
_CAPABILITY_VERSION_3 = 0x20080522
_CAP_DAC_OVERRIDE = 1

_libc = ctypes.CDLL(None, use_errno=True)


def _become(uid: int) -> None:
    """uid, with CAP_DAC_OVERRIDE alone (capabilities(7)); without that right at least the uid."""
    _libc.prctl(_PR_SET_KEEPCAPS, 1, 0, 0, 0)
    os.setgroups([])
    os.setgid(uid)
    os.setuid(uid)
    bit = 1 << _CAP_DAC_OVERRIDE
    header = (ctypes.c_uint32 * 2)(_CAPABILITY_VERSION_3, 0)
    sets = (ctypes.c_uint32 * 6)(bit, bit, bit, 0, 0, 0)  # effective, permitted, inheritable; then the upper halves
    if _libc.capset(header, sets) == 0:
        _libc.prctl(_PR_CAP_AMBIENT, _PR_CAP_AMBIENT_RAISE, _CAP_DAC_OVERRIDE, 0, 0)


def main() -> None:
    parent, signal_number, uid = (int(text) for text in sys.argv[1:4])
    if uid:
        _become(uid)
    _libc.prctl(_PR_SET_PDEATHSIG, signal_number, 0, 0, 0)  # after the change of uid, which clears it
    if os.getppid() != parent:  # it died before the kernel was told
        os._exit(1)
    os.execvp(sys.argv[4], sys.argv[4:])


if __name__ == "__main__":
    main()
