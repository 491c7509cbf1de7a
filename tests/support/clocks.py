"""Clocks that a test sets, of programs that preload ripnerf-wallclock.so."""

import struct

YEAR_S = 31557600


class Clocks:
    def __init__(self, path, library):
        self.path = path
        self.set(0)
        self.environment = {"LD_PRELOAD": str(library), "RIPNERF_WALL_SHIFT": str(path)}

    def set(self, years, uptime_s=0):
        """The wall clock, and how long the machine is up: ahead by so much. The file is mapped by
        the programs: it is written where it lies."""
        with open(self.path, "r+b" if self.path.exists() else "wb") as file:
            file.write(struct.pack("<qq", years * YEAR_S, uptime_s))
