"""The test's end of the preloaded faults.c."""

import ctypes
import mmap
import os

KINDS = ["none", "malloc", "write", "short-write", "sync", "open", "rename", "mkdir", "socket",
         "accept", "read"]


class Plan(ctypes.Structure):
    _fields_ = [("kind", ctypes.c_int), ("left", ctypes.c_int), ("hits", ctypes.c_int),
                ("error", ctypes.c_int), ("for_good", ctypes.c_int),
                ("program", ctypes.c_char * 16)]


class Faults:
    """faults.arm("write", 3, errno.ENOSPC): the third write from now on fails."""

    def __init__(self, build, path, program):
        path.write_bytes(bytes(4096))
        self.environment = {"RIPNERF_FAULTS": str(path),
                            "LD_PRELOAD": str(build / "tests" / "support" / "ripnerf-faults.so")}
        assert os.path.exists(self.environment["LD_PRELOAD"])
        with open(path, "r+b") as file:
            self.plan = Plan.from_buffer(mmap.mmap(file.fileno(), 4096))
        self.plan.program = program.encode()[:15]

    def arm(self, kind, number, error=0, for_good=False):
        self.plan.kind = 0
        self.plan.hits, self.plan.left, self.plan.error = 0, number, error
        self.plan.for_good = for_good
        self.plan.kind = KINDS.index(kind)

    def disarm(self):
        """How many calls have failed."""
        self.plan.kind = 0
        return self.plan.hits
