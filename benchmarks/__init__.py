"""How fast the program is, beside its peers and beside what the machine allows. See docs/performance.md."""

import os

# As a worker has it: numpy's library would take every core, and time of all of them is counted.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
