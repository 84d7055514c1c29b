"""The command line: the commands that check, run, resume and look.

A command has its process to itself, which Python's garbage collector would hold up. What imports make stays, and
looking through it again and again is 10 % of a start; a time step leaves nothing that the collector has to find. At
the end Python would unlink all objects one by one, for a third of a second, before the system takes the memory back at
once.
"""

import atexit
import gc

gc.set_threshold(50_000)
atexit.register(gc.freeze)
