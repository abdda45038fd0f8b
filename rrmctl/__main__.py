"""`python -m rrmctl`: the program, by the Python that is to run it."""

import os
import sys
from pathlib import Path

from rrmctl.cli.app import main

if __name__ == "__main__":
    here = str(Path(__file__).parents[1])
    if sys.path[0] == here:  # found in the working directory, where the processes that it starts do not look
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [here, os.environ.get("PYTHONPATH")]))
    main()
