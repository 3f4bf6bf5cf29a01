"""Run by the manager: argv is a file of names and a command. Loads the filter of SystemCallFilter=, then becomes it.

What is not named fails with EPERM, as with SystemCallErrorNumber=EPERM.
"""

from __future__ import annotations

import ctypes
import errno
import os
import sys

ALLOW = 0x7FFF0000
ERRNO = 0x00050000


def main() -> None:
    library = ctypes.CDLL("libseccomp.so.2", use_errno=True)  # what systemd itself uses
    library.seccomp_init.restype = ctypes.c_void_p
    context = ctypes.c_void_p(library.seccomp_init(ctypes.c_uint32(ERRNO | errno.EPERM)))
    with open(sys.argv[1]) as file:
        names = file.read().split()
    for name in names:
        number = library.seccomp_syscall_resolve_name(name.encode())
        if number >= 0:  # this machine has it
            assert library.seccomp_rule_add(context, ctypes.c_uint32(ALLOW), number, 0) == 0, name
    assert library.seccomp_load(context) == 0
    os.execv(sys.argv[2], sys.argv[2:])


if __name__ == "__main__":
    main()
