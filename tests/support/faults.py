"""The test's end of the preloaded faults.c."""

import ctypes
import mmap
import os

KINDS = ["none", "malloc", "write", "short-write", "sync", "open", "rename", "mkdir", "socket",
         "accept", "read", "unlink", "truncate", "send", "poll", "thread", "map", "spawn", "call"]
DISTINCT, SURVEY = len(KINDS) + 1, len(KINDS) + 2
DEPTH, STACKS = 24, 1 << 16


class Frame(ctypes.Structure):
    _fields_ = [("offset", ctypes.c_uint64), ("module", ctypes.c_char * 40)]


class Plan(ctypes.Structure):
    _fields_ = [("kind", ctypes.c_int), ("left", ctypes.c_int), ("hits", ctypes.c_int),
                ("error", ctypes.c_int), ("for_good", ctypes.c_int),
                ("program", ctypes.c_char * 16), ("chance", ctypes.c_uint),
                ("seed", ctypes.c_uint), ("last_kind", ctypes.c_int), ("last_depth", ctypes.c_int),
                ("last", Frame * DEPTH), ("met", ctypes.c_uint64 * STACKS)]


def mapped(path, kind):
    """The file as what `kind` says, in memory; zeros where there is none yet."""
    with open(path, "a+b") as file:
        file.truncate(ctypes.sizeof(kind))
        return kind.from_buffer(mmap.mmap(file.fileno(), ctypes.sizeof(kind)))


class Faults:
    """faults.arm("write", 3, errno.ENOSPC): the third write from now on fails. `tried`: a file that keeps
    the stacks that have failed; others may use it meanwhile."""

    def __init__(self, build, path, program, tried=None):
        tried = tried or path.with_suffix(".tried")
        self.environment = {"RIPNERF_FAULTS": str(path), "RIPNERF_FAULTS_TRIED": str(tried),
                            "ASAN_OPTIONS": "verify_asan_link_order=0:detect_leaks=0",
                            "LD_PRELOAD": str(build / "tests" / "support" / "ripnerf-faults.so")}
        assert os.path.exists(self.environment["LD_PRELOAD"])
        self.plan, self.table = mapped(path, Plan), mapped(tried, ctypes.c_uint64 * STACKS)
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

    def arm_stacks(self, chance=256, seed=0):
        """The next call of any kind whose stack is new fails, one alone."""
        self.plan.kind = 0
        self.plan.hits, self.plan.left, self.plan.chance, self.plan.seed = 0, 1, chance, seed
        self.plan.kind = DISTINCT

    def survey(self):
        """From now on stacks are noted and nothing fails."""
        self.plan.kind = 0
        self.plan.hits, self.plan.left, self.plan.chance = 0, 1 << 30, 256
        self.plan.kind = SURVEY

    def met(self):
        return set(self.plan.met) - {0}

    def tried(self):
        return set(self.table) - {0}

    def last(self):
        """The call that failed last: its kind and its stack, as `addr2line -e MODULE` takes it."""
        frames = self.plan.last[:self.plan.last_depth]
        return KINDS[self.plan.last_kind] + ": " + " ".join(
            f"{frame.module.decode()}+{frame.offset:#x}" for frame in frames)

    def is_within(self, libraries):
        """Whether one of these asked for what failed last, by the C library's functions or by itself."""
        asked = (frame.module.decode() for frame in self.plan.last[:self.plan.last_depth])
        return next(name for name in asked if not name.startswith(("ripnerf-held.so", "libc.so"))).startswith(libraries)
